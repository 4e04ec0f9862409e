"""Registry of drivers: entry points of the group ``skincal.drivers``, or ``module:Class``.

A lab's own package names its driver in its ``pyproject.toml``, where skincal finds it::

    [project.entry-points."skincal.drivers"]
    my-hand = "my_package.my_hand:MyHand"

The keyword parameters of the driver's class are its options. Their annotations define how the text of a command line
is converted, and what ``Annotated`` adds to them is their help.
"""

from __future__ import annotations

import importlib
import inspect
import types
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin, get_type_hints

from skincal.bounded import number_in
from skincal.errors import InputError, Problem, SkincalError, WorkError, input_error, quoted, shown, text_of
from skincal.hand.driver import HandDriver, StageDescription, StageDriver
from skincal.robot.description import HandDescription

GROUP = "skincal.drivers"
"""Name of the entry point group."""


@dataclass(frozen=True)
class DriverOption:
    """An option of a driver.

    Attributes:
        name: its name.
        kind: its annotation.
        default: its default; ``inspect.Parameter.empty``: it must be given.
        text: help text; may be empty.
    """

    name: str
    kind: Any
    default: Any
    text: str = ""

    @property
    def required(self) -> bool:
        """True if the option must be given."""
        return self.default is inspect.Parameter.empty


def driver_names() -> tuple[str, ...]:
    """Return the names of all installed drivers, in alphabetical order."""
    return tuple(sorted({point.name for point in entry_points(group=GROUP)}))


def driver_class(name: str) -> Callable[..., HandDriver | StageDriver]:
    """Return the class of a driver, or its factory function.

    Raises:
        InputError: there is no driver of that name, or two.
        WorkError: it cannot be imported.
    """
    points = [EntryPoint(name, name, GROUP)] if ":" in name else list(entry_points(group=GROUP, name=name))
    if not points:
        choices = ", ".join(driver_names()) or "none is installed"
        fix = f"Register a driver by an entry point of the group {GROUP}."
        raise input_error("driver", f"module:Class or one of: {choices}", f'"{name}"', fix)
    values = {point.value for point in points}
    if len(values) > 1:
        fix = "Give the intended one as module:Class, or uninstall the other."
        raise input_error(f'driver "{name}"', "one entry point", " and ".join(sorted(values)), fix)
    return _loaded(name, points[0])


def driver_options(name: str) -> tuple[DriverOption, ...]:
    """Return the options of a driver, in the order of its class; errors are those of :func:`driver_class`."""
    made = driver_class(name)
    hints: Mapping[str, Any] = {}
    with suppress(Exception):  # names that only a type checker knows
        hints = get_type_hints(made.__init__ if inspect.isclass(made) else made, include_extras=True)
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    options: list[DriverOption] = []
    try:
        parameters = inspect.signature(made).parameters.values()
    except (TypeError, ValueError):  # one of the interpreter's own, no driver
        return ()
    for parameter in parameters:
        if parameter.kind not in named:
            continue
        kind, text = hints.get(parameter.name, str), ""
        if get_origin(kind) is Annotated:
            kind, *notes = get_args(kind)
            text = next((note for note in notes if isinstance(note, str)), "")
        options.append(DriverOption(parameter.name, kind, parameter.default, text))
    return tuple(options)


def create_driver(name: str, /, **options: Any) -> HandDriver:
    """Create the driver of a hand, not connected yet. See :func:`create_rig`."""
    driver = create_rig(name, **options)
    if isinstance(driver, StageDriver):
        got = "one of a stage; use it with `skincal collect` or `skincal hand test`"
        raise input_error(f'driver "{name}"', "the driver of a hand", got)
    return driver


def create_rig(name: str, /, **options: Any) -> HandDriver | StageDriver:
    """Create a driver of a hand or of a stage, not connected yet.

    Args:
        name: a registered name, or ``module:Class``.
        options: the driver's options. Text is converted to the annotated type, anything else is passed on.

    Raises:
        InputError: an unknown name or option, a missing option, or an invalid value.
        WorkError: the driver cannot be imported or created.
    """
    made = driver_class(name)
    known = {option.name: option for option in driver_options(name)}
    problems = [_unknown(name, key, known) for key in options if key not in known]
    for key, option in known.items():
        if option.required and key not in options:
            expected = f"the option {key} ({type_text(option.kind)})"
            fix = f"Add --driver-option {key}=VALUE."
            problems.append(Problem(f'driver "{name}"', expected, "nothing", fix))
    values: dict[str, Any] = {}
    for key, value in options.items():
        try:
            if key in known:
                values[key] = converted(value, known[key].kind)
        except ValueError as error:
            place = f'driver "{name}", option {key}'
            problems.append(Problem(place, str(error), repr(value)))
    if problems:
        raise InputError(problems)
    try:
        driver = made(**values)
        # Whatever its class computes is asked for here, before anything moves.
        described, *_ = (getattr(driver, what, None) for what in ("description", "name", "real_time"))
    except (SkincalError, KeyboardInterrupt):
        raise
    except BaseException as error:  # a driver may raise SystemExit, or CancelledError, which ends no process
        raise WorkError(f'driver "{name}" cannot be created: {quoted(error)}') from error
    if not isinstance(driver, HandDriver | StageDriver):  # pyright: ignore[reportUnnecessaryIsInstance]
        expected = "a subclass of skincal.hand.HandDriver or StageDriver"
        raise input_error(f'driver "{name}"', expected, type(driver).__name__)
    kind = StageDescription if isinstance(driver, StageDriver) else HandDescription
    if not isinstance(described, kind):
        raise input_error(f'driver "{name}", description', f"a {kind.__name__}", shown(described))
    return driver


def parse_options(texts: list[str]) -> dict[str, str]:
    """Return options of a command line, each ``KEY=VALUE``; a dash in a key becomes an underscore.

    Raises:
        InputError: a text lacks ``=``, or a key is given twice.
    """
    options: dict[str, str] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        key = key.strip().replace("-", "_")
        if not equals or not key:
            raise input_error("--driver-option", "KEY=VALUE", f'"{text}"')
        if key in options:
            raise input_error("--driver-option", "each key once", f"{key} twice")
        options[key] = value
    return options


def _loaded(name: str, point: EntryPoint) -> Callable[..., HandDriver | StageDriver]:
    module, _, attribute = point.value.partition(":")
    try:
        value: Any = importlib.import_module(module)
        for part in attribute.split("."):
            value = getattr(value, part)
    except SkincalError:
        raise
    except ModuleNotFoundError as error:
        if error.name is not None and (module == error.name or module.startswith(f"{error.name}.")):
            fix = "Run from the folder that holds it, or install its package."
            raise input_error(f'driver "{name}"', f"a module {module}", "none", fix) from error
        raise WorkError(f'driver "{name}" needs the package {error.name}, which is not installed') from error
    except AttributeError as error:
        raise input_error(f'driver "{name}"', f"{attribute} in {module}", text_of(error)) from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise WorkError(f'driver "{name}" cannot be imported: {quoted(error)}') from error
    if not callable(value):
        raise input_error(f'driver "{name}"', "a class", type(value).__name__)
    return cast(Callable[..., HandDriver | StageDriver], value)


def _unknown(name: str, key: str, known: Mapping[str, DriverOption]) -> Problem:
    texts = [option for option in known.values() if is_text(option.kind)]
    choices = ", ".join(f"{o.name} ({type_text(o.kind)})" for o in texts) or "none; it has no options"
    return Problem(f'driver "{name}"', f"an option of: {choices}", f'"{key}"')


TRUE, FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")


def converted(value: Any, kind: Any) -> Any:
    """Return a value of a type; anything but text is accepted as it is.

    Text is read as ``int``, ``float``, ``bool``, ``str``, ``Path`` or one of a ``Literal``; ``tuple[T, ...]`` and
    ``Sequence[T]`` as ``A,B,C``, ``Mapping[str, T]`` as ``NAME=A,NAME=B``, and ``T | None`` as T, or ``none``.

    Raises:
        ValueError: the text cannot be converted; the message says what was expected.
    """
    if not isinstance(value, str) or kind is str or kind is Any:
        return value
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return _one_of(value, arguments)
    if origin is Literal:
        if value not in arguments:
            raise ValueError(f"one of {', '.join(map(str, arguments))}")
        return value
    parts = [*filter(None, (part.strip() for part in value.split(",")))]
    if _is_a(Mapping, kind):
        return _mapping(parts, (arguments or (str, str))[1])
    if _is_a(Sequence, kind):
        return tuple(converted(part, (arguments or (str,))[0]) for part in parts)
    return _plain(value, kind)


def type_text(kind: Any) -> str:
    """Return the readable name of an annotation."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return " or ".join(type_text(a) for a in arguments)
    if origin is Literal:
        return " or ".join(map(str, arguments))
    if _is_a(Mapping, kind):
        return f"NAME={type_text((arguments or (str, str))[1])},..."
    if _is_a(Sequence, kind):
        return f"{type_text((arguments or (str,))[0])},..."
    plain = {int: "whole number", float: "number", bool: "true or false", str: "text", Path: "path"}
    return {**plain, type(None): "none"}.get(kind, getattr(kind, "__name__", str(kind)))


def is_text(kind: Any) -> bool:
    """Return whether a value of this type can be given as text; other types are for programs."""
    if get_origin(kind) in (Union, types.UnionType):
        return any(is_text(a) for a in get_args(kind) if a is not type(None))
    plain = kind in (int, float, bool, str, Path, Any) or get_origin(kind) is Literal
    return plain or _is_a(Mapping, kind) or _is_a(Sequence, kind)


def _one_of(value: str, kinds: Sequence[Any]) -> Any:
    if type(None) in kinds and value.lower() == "none":
        return None
    expected: list[str] = []
    # Every text can be read as text: try the other types first.
    for kind in sorted((k for k in kinds if k is not type(None)), key=lambda k: k in (str, Path)):
        try:
            return converted(value, kind)
        except ValueError as error:
            expected.append(str(error))
    raise ValueError(" or ".join(expected))


def _plain(value: str, kind: Any) -> Any:
    if kind is bool:
        if value.lower() not in TRUE + FALSE:
            raise ValueError("true or false")
        return value.lower() in TRUE
    if kind in (int, float):
        return number_in(value, kind)
    if kind is Path:
        return Path(value).expanduser()
    raise ValueError(f"a {type_text(kind)}, which cannot be given as text")


def _mapping(parts: Sequence[str], kind: Any) -> Mapping[str, Any]:
    read: dict[str, Any] = {}
    for part in parts:
        name, equals, text = part.partition("=")
        if not equals:
            raise ValueError("NAME=VALUE,...")
        read[name.strip()] = converted(text.strip(), kind)
    return read


def _is_a(base: type, kind: Any) -> bool:
    own = get_origin(kind) or kind
    return isinstance(own, type) and issubclass(own, base) and own is not str
