"""What the verbs share: their options, results on standard output, messages on standard error."""

from __future__ import annotations

import json
import math
import os
import shlex
import sys
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from skincal.errors import InputError, Problem

if TYPE_CHECKING:
    from rich.table import Table


def option(text: str, *names: str, **settings: Any) -> Any:
    """Return an option with its help text; without names it is called as its parameter."""
    return typer.Option(*names, help=text, **settings)


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
DatasetArgument = Annotated[Path, argument("DATASET", "Folder of a dataset.")]
CalibrationArgument = Annotated[Path, argument("CAL", "Folder of a calibration.")]
OutOption = Annotated[Path, option("Folder to write; it appears complete or not at all.", "--out")]
JsonOption = Annotated[bool, option("Print one JSON object, and nothing else, on standard output.", "--json")]
ForceOption = Annotated[bool, option("Replace an earlier output of skincal.", "--force")]
ReportOption = Annotated[bool, option("Write the report: HTML page and pictures.")]
SeedOption = Annotated[int, option("Seed of all randomness; the same seed gives the same result.", min=0)]
DriverOption = Annotated[
    str,
    option("Driver of the hand: a name of `skincal hand list`, or module:Class.", callback=find_modules_here),
]
_OPTIONS = "An option of the driver; may be repeated. `skincal hand list` shows them."
DriverOptionsOption = Annotated[list[str] | None, option(_OPTIONS, "--driver-option", metavar="KEY=VALUE")]
_EFFECT = "Effect of a simulated skin; strength 1 is a typical case. May be repeated."
EffectOption = Annotated[list[str] | None, option(_EFFECT, metavar="NAME=STRENGTH")]
BeyondLimitsOption = Annotated[
    bool, option("Accept limits in hand.toml that are beyond those of any finger.", "--beyond-limits")
]


def example(*commands: str) -> str:
    """Return the epilog of a verb's help: commands as a person types them."""
    # The first line tells click to keep the line breaks.
    return "\b\nExample:\n" + "\n".join(f"  {command}" for command in commands)


def wrong(place: str, expected: str, got: object, fix: str = "") -> InputError:
    """Return the error of one wrong option or input."""
    return InputError([Problem(place, expected, str(got), fix)])


def numbers_by_name(name: str, given: Iterable[str] | None, metavar: str = "NAME=VALUE") -> dict[str, float]:
    """Return the numbers of a repeated option ``NAME=VALUE``.

    Raises:
        InputError: one is no number, or is given twice.
    """
    found: dict[str, float] = {}
    for text in given or ():
        key, _, value = text.partition("=")
        if key.strip() in found:
            raise wrong(name, "each name once", f"{key.strip()} twice")
        try:
            found[key.strip()] = float(value)
        except ValueError:
            raise wrong(name, f"{metavar} with a number", repr(text)) from None
    return found


def command_line() -> str:
    """Return the command that is running, for the provenance of its output."""
    return shlex.join(["skincal", *sys.argv[1:]])


def answer(as_json: bool, content: Mapping[str, Any], *shown: object) -> None:
    """Print the result of a verb on standard output.

    Args:
        as_json: whether to print one JSON object, and nothing else.
        content: the object.
        shown: lines and tables for a person.
    """
    if as_json:
        print_json(content)
        return
    for part in shown:
        if isinstance(part, str):
            typer.echo(part)
        else:
            from rich.console import Console

            Console().print(part)


def table(
    columns: Iterable[str], rows: Iterable[Sequence[Any]], *, right: bool = False, **look: Any
) -> Table:
    """Return a table for the terminal.

    Args:
        columns: titles.
        rows: cells of each row.
        right: whether all columns but the first are numbers.
        look: settings of :class:`rich.table.Table`.
    """
    from rich.table import Table

    made = Table(**{"box": None, "padding": (0, 2, 0, 0), **look})
    for number, title in enumerate(columns):
        made.add_column(title, justify="right" if right and number else "left", no_wrap=not number)
    for row in rows:
        made.add_row(*row)
    return made


def print_json(content: Mapping[str, Any]) -> None:
    """Print one JSON object on standard output; NaN and inf, which JSON lacks, become null."""
    print(json.dumps(plain(content), allow_nan=False), file=_for_json[-1], flush=True)


_for_json: list[TextIO | None] = [None]
"""Stream for JSON; None: standard output."""


@contextmanager
def json_alone(wanted: bool) -> Generator[None]:
    """Redirect other output, such as that of a driver or a library, to standard error while ``--json`` is on.

    Args:
        wanted: whether the verb has that option.
    """
    kept: TextIO | None = sys.stdout
    if not wanted or kept is None:  # it may be closed
        yield
        return
    with ExitStack() as stack:
        stack.callback(setattr, sys, "stdout", kept)
        stack.callback(_for_json.pop)
        if kept is sys.__stdout__:
            # Libraries that are not Python's write to the descriptor.
            kept.flush()
            out, descriptor = os.dup(1), 1
            stack.callback(os.close, out)
            stack.callback(os.dup2, out, descriptor)
            os.dup2(2, descriptor)
            sink = stack.enter_context(os.fdopen(out, "w", encoding="utf-8", closefd=False))
        else:
            sink = kept
        _for_json.append(sink)
        sys.stdout = sys.stderr
        yield


def plain(value: Any) -> Any:
    """Return a value as JSON has it: arrays as lists, paths as text, NaN and inf as null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, str) or value is None or isinstance(value, bool):
        return value
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):  # numpy arrays and scalars, without importing numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Iterable):
        return [plain(item) for item in value]
    return value


def say(message: str) -> None:
    """Print a message on standard error; do nothing where the terminal is gone."""
    with suppress(OSError):
        typer.echo(message, err=True)


def problems_json(problems: Iterable[Problem]) -> list[dict[str, str]]:
    """Return problems as JSON objects."""
    return [{"place": p.place, "expected": p.expected, "got": p.got, "fix": p.fix} for p in problems]


def findings_json(problems: Iterable[Problem]) -> list[dict[str, Any]]:
    """Return problems with their codes, for programs."""
    return [
        {
            "code": p.code,
            "severity": p.severity,
            "text": f"{p.place}: expected {p.expected}; got {p.got}",
            "advice": p.fix,
            **p.details,
        }
        for p in problems
        if p.code
    ]


def warn(problems: Iterable[Problem]) -> None:
    """Print warnings on standard error."""
    for problem in problems:
        say(f"skincal: {problem.severity}: {problem}")


def note(texts: Iterable[str]) -> None:
    """Print notes on standard error."""
    for text in texts:
        say(f"skincal: note: {text}")


def shape(kind: str, radius_m: float | None) -> str:
    """Return a surface or an indenter in a few words."""
    return kind if radius_m is None else f"{kind} of radius {radius_m * 1e3:g} mm"


def first_of(items: Sequence[object], most: int = 8) -> str:
    """Return a list in one line, cut after so many."""
    more = f" and {len(items) - most} more" if len(items) > most else ""
    return ", ".join(map(str, items[:most])) + more


def say_calibration(out: Path, report: bool) -> None:
    """Print where a calibration and its report were written."""
    say(f"calibration: {out}" + (f"   report: {out / 'report.html'}" if report else ""))
