"""Errors that say what was expected, what came and what to do.

Every error a person can cause or mend is a :class:`SkincalError`. The command line turns it into a few lines
on standard error and its ``exit_status``; a library user catches it as an ordinary exception.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, cast


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong, and where.

    Attributes:
        place: file, and the place in it: ``presses.csv, column force_n, row 7``.
        expected: what should have been there.
        got: what was there.
        fix: what to do about it; empty where the expectation says it already.
        code: a word that programs can ask for; '' for most.
        severity: ``warning``, or ``note`` for what may well be meant so.
        details: what programs may want besides: a ``factor`` that mends a unit, the ``presses`` that are meant.
    """

    place: str
    expected: str
    got: str
    fix: str = ""
    code: str = ""
    severity: str = "warning"
    details: Mapping[str, Any] = field(default_factory=dict[str, Any], compare=False)

    def __str__(self) -> str:
        place, expected, fix = cut(self.place), cut(self.expected, 1000), cut(self.fix, 1000)
        text = _shown(f"{place}: expected {expected}; got {cut(self.got)}")
        if not fix:
            return text
        return f"{text}{'' if text.endswith((*'.?…',)) else '.'} {fix}"


def cut(text: str, most: int = 500) -> str:
    """Return a text of a file, of a length that can be read."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def readable(text: str) -> str:
    """Return a text with names of files as UTF-8 has them, whatever the system's encoding of names is."""
    with suppress(UnicodeEncodeError):  # half of a surrogate pair, of no name
        text = text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    return text


def _shown(text: str) -> str:
    """A text without what would steer a terminal; no name or value of a file can."""
    text = readable(text)
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def text_of(error: BaseException, most: int = 200) -> str:
    """Return the text of a foreign exception: one line, printable, of at most ``most`` letters; it never raises.

    An exception of a driver, a library or a plug-in may raise, in any way, when it is asked for its text, or give
    megabytes. Of a group the first members are told as well, as its own text says only how many there are.
    """
    return _line(error, _text, most)


def quoted(error: BaseException, most: int = 200) -> str:
    """Return the class of a foreign exception, and its :func:`text_of`."""
    name, text = _line(error, lambda one: type(one).__name__, 60), text_of(error, most)
    return f"{name}: {text}" if text else name


def _line(error: BaseException, text_of: Callable[[BaseException], str], most: int) -> str:
    try:
        text = str.__str__(text_of(error))  # a subclass may come with methods of its own
    except BaseException:  # also SystemExit, and a KeyboardInterrupt that is not the user's
        return "an error whose text cannot be read"
    return one_line(text, most)


def one_line(text: str, most: int) -> str:
    """Return a foreign text as one line without what would steer a terminal, of at most ``most`` letters."""
    return cut(_shown(" ".join(str(text)[: 8 * most].split())), most)


def _text(error: BaseException) -> str:
    if not isinstance(error, BaseExceptionGroup):
        return str(error)
    members: list[BaseException] = []
    rest: list[BaseException] = [error]
    while rest and len(members) < 3:
        one = rest.pop()
        if isinstance(one, BaseExceptionGroup):
            rest += reversed(cast("BaseExceptionGroup[BaseException]", one).exceptions)
        else:
            members.append(one)
    return f"{error.message}: {'; '.join(map(quoted, members))}"


def first_of(words: Iterable[object], shown: int = 3, total: int | None = None) -> str:
    """Return the first words of a list, and how many more of ``total`` there are."""
    every = [*map(str, words)]
    more = (len(every) if total is None else total) - shown
    return ", ".join(every[:shown]) + (f" and {more} more" if more > 0 else "")


_PLAIN: tuple[type, ...] = (bool, int, float, complex, str, bytes, type(None))


def shown(value: Any) -> str:
    """Return a short text for a value of wrong type or shape, without running code of its own.

    The ``repr`` of a foreign class, also of one within a list, may raise or never return.
    """
    kind = cast("type[Any]", type(value))
    if kind.__module__ == "numpy" and hasattr(value, "shape"):  # an array, without importing numpy
        return f"an array of {value.dtype} of shape {value.shape}"
    if kind in _PLAIN:
        with suppress(ValueError):  # a whole number of thousands of digits
            return f"{kind.__name__} {reprlib.repr(value):.60}"
    return f"{kind.__name__} of {len(value)}" if kind in (list, tuple, dict, set) else kind.__name__


class SkincalError(Exception):
    """Base of all errors of skincal. ``exit_status`` is what the command line exits with."""

    exit_status = 1


class InputError(SkincalError):
    """The command line or an input file is wrong.

    Attributes:
        problems: every violation that was found, in the order of the file.
    """

    exit_status = 2

    def __init__(self, problems: Sequence[Problem] | str) -> None:
        self.problems: tuple[Problem, ...] = () if isinstance(problems, str) else tuple(problems)
        super().__init__(problems if isinstance(problems, str) else "\n".join(str(p) for p in problems))

    def __reduce__(self) -> tuple[type[InputError], tuple[Sequence[Problem] | str]]:
        """Keep the problems when the error is sent to another process."""
        return type(self), (self.problems or str(self),)


def input_error(place: str, expected: str, got: object, fix: str = "") -> InputError:
    """Return the error of a single problem; arguments are those of :class:`Problem`."""
    return InputError([Problem(place, expected, str(got), fix)])


def check_options(options: Any, expected: str, is_good: Callable[[Any], bool], *exempt: str) -> None:
    """Check the fields of a dataclass of options, apart from those that are exempt.

    Raises:
        InputError: some fields are not as expected; all are reported.
    """
    problems = [
        Problem(f"{type(options).__name__}.{name}", expected, repr(value))
        for name, value in cast("dict[str, Any]", vars(options)).items()
        if name not in exempt and not is_good(value)
    ]
    if problems:
        raise InputError(problems)


class WorkError(SkincalError):
    """The input is well formed, but the work cannot be done with it (a fit that does not converge, say)."""
