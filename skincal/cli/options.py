"""Options that verbs share, declared once, and their readers."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from skincal.errors import InputError, input_error, readable
from skincal.tasks import DURATION_S, Task


def option(text: str, *names: str, **settings: Any) -> Any:
    """Return an option with its help text; without names it is called as its parameter. Its numbers are bounded."""
    return typer.Option(*names, help=text, **{"callback": _bounded, **settings})


def _bounded(value: Any) -> Any:
    """Refuse numbers of an option that are not finite, or beyond the bounds of those in files."""
    for one in value if isinstance(value, tuple | list) else (value,):
        if isinstance(one, int | float):
            from skincal.bounded import check_number

            try:
                check_number(one)
            except ValueError as error:
                raise typer.BadParameter(f"expected {error}; got {one:g}") from None
    return value


def argument(metavar: str | None, text: str, **settings: Any) -> Any:
    """Return an argument with its help text."""
    return typer.Argument(metavar=metavar, help=text, **settings)


def find_modules_here(driver: str) -> str:
    """Let ``module:Class`` name a module of the working folder, which comes last so that it hides nothing installed."""
    here = str(Path.cwd())
    if ":" in driver and here not in sys.path:
        sys.path.append(here)
    return driver


Pair = tuple[float, float]
DURATIONS = ", ".join(f"{DURATION_S[task]:g} {task}" for task in (Task.marble, Task.bolt))
Dataset = Annotated[Path, argument("DATASET", "Folder of a dataset.")]
Calibration = Annotated[Path, argument("CAL", "Folder of a calibration.")]
Out = Annotated[Path, option("Folder to write; it appears complete or not at all.", "--out")]
Json = Annotated[bool, option("Print one JSON object, and nothing else, on standard output.", "--json")]
Force = Annotated[bool, option("Replace an earlier output of skincal.", "--force")]
Report = Annotated[bool, option("Write the report: HTML page and pictures.")]
Seed = Annotated[
    int, option("Seed of all randomness; the same seed gives the same result.", min=0, max=2**63 - 1)
]
Workers = Annotated[int | None, option("Number of processes.", min=1, max=1024, show_default="one per core")]
Driver = Annotated[
    str,
    option("Driver of the hand: a name of `skincal hand list`, or module:Class.", callback=find_modules_here),
]
_OPTIONS = "An option of the driver; may be repeated. `skincal hand list` shows them."
DriverOptions = Annotated[list[str] | None, option(_OPTIONS, "--driver-option", metavar="KEY=VALUE")]
Hand = Annotated[str | None, option("Name of the hand, or its hand.toml, for drivers that take one.")]
_EFFECT = "Effect of a simulated skin; strength 1 is a typical case. May be repeated."
Effects = Annotated[list[str] | None, option(_EFFECT, metavar="NAME=STRENGTH")]
BeyondLimits = Annotated[
    bool, option("Accept limits in hand.toml that are beyond those of any finger.", "--beyond-limits")
]


def example(*commands: str) -> str:
    """Return the epilog of a verb's help: commands as a person types them."""
    # The first line tells click to keep the line breaks.
    return "\b\nExample:\n" + "\n".join(f"  {command}" for command in commands)


def numbers_by_name(name: str, given: Iterable[str] | None, metavar: str = "NAME=VALUE") -> dict[str, float]:
    """Return the numbers of a repeated option ``NAME=VALUE``.

    Raises:
        InputError: one is no number, or is given twice.
    """
    from skincal.bounded import number_in

    found: dict[str, float] = {}
    for text in given or ():
        key, _, value = text.partition("=")
        if key.strip() in found:
            raise input_error(name, "each name once", f"{key.strip()} twice")
        try:
            found[key.strip()] = number_in(value, float)
        except ValueError as error:
            raise input_error(name, f"{metavar} with {error}", repr(text)) from None
    return found


@contextmanager
def options_named(*names: str) -> Generator[None]:
    """Call arguments of a function in its errors as the options that they come from."""
    try:
        yield
    except InputError as error:
        if not error.problems:
            raise
        named = [replace(one, place="--" * (one.place in names) + one.place) for one in error.problems]
        raise InputError(named) from error


def command_line() -> str:
    """Return the command that is running, for the provenance of its output."""
    return readable(shlex.join(["skincal", *sys.argv[1:]]))
