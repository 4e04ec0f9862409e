"""Output of verbs: results on standard output, messages on standard error."""

from __future__ import annotations

import json
import math
import os
import re
import sys
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import typer

from skincal.errors import Problem, readable

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table


def answer(as_json: bool, content: Mapping[str, Any], *shown: RenderableType, then: str = "") -> None:
    """Print the result of a verb on standard output; ``then`` follows for a person, on standard error."""
    if as_json:
        print_json(content)
        return
    for part in shown:
        if isinstance(part, str):
            print(readable(part), flush=True)  # typer would write UTF-8 to a terminal that lacks it
        else:
            from rich.console import Console

            console = Console()
            # Where columns need more than the terminal has, it breaks lines, but never numbers.
            least = console.measure(part, options=console.options.update(max_width=1000)).minimum
            console.print(part, width=max(console.width, least), crop=False)
    if then:
        say(then)


def table(
    columns: Iterable[str], rows: Iterable[Sequence[Any]], *, right: bool = False, **look: Any
) -> Table:
    """Return a table for the terminal; where columns are numbers (``right``), their cells stay on one line."""
    from rich.cells import cell_len
    from rich.table import Table

    rows = list(rows)
    made = Table(**{"box": None, "padding": (0, 2, 0, 0), **look})
    for number, title in enumerate(columns):
        numbers = right and number > 0
        cells = [str(row[number]) for row in rows if number < len(row)]
        least = (
            max(cell_len(line) for cell in (title, *cells) for line in cell.split("\n")) if numbers else None
        )
        justify = "right" if numbers else "left"
        made.add_column(title, justify=justify, no_wrap=numbers or not number, min_width=least)
    for row in rows:
        made.add_row(*row)
    return made


def picked(source: object, names: str) -> dict[str, Any]:
    """Return some attributes of an object by name, for JSON."""
    return {name: getattr(source, name) for name in names.split()}


def print_json(content: Mapping[str, Any]) -> None:
    """Print one JSON object on standard output; NaN and inf, which JSON lacks, become null."""
    print(json.dumps(plain(content), allow_nan=False), file=_for_json[-1], flush=True)


_for_json: list[TextIO | None] = [None]
"""Stream for JSON; None: standard output."""


@contextmanager
def json_alone(wanted: bool) -> Generator[None]:
    """Redirect other output, such as that of a driver or a library, to standard error while ``--json`` is on."""
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
    if isinstance(value, str | Path):
        return readable(str(value))
    if value is None or isinstance(value, bool):
        return value
    if hasattr(value, "tolist"):  # numpy arrays and scalars, without importing numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Iterable):
        return [plain(item) for item in value]
    return value


def say(message: str) -> None:
    """Print a message on standard error; do nothing where the terminal is gone.

    It may hold names and texts of files, so control characters, which terminals obey, are shown as codes.
    """
    with suppress(OSError):
        typer.echo(_CONTROL.sub(lambda found: f"\\x{ord(found[0]):02x}", readable(message)), err=True)


_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


def problems_json(problems: Iterable[Problem]) -> list[dict[str, str]]:
    """Return problems as JSON objects."""
    return [picked(problem, "place expected got fix") for problem in problems]


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


MOST_LISTED = 8
"""Items of a list that are printed in a line."""


def calibration_line(out: Path, report: bool) -> str:
    """Return where a calibration and its report were written."""
    return f"calibration: {out}" + (f"   report: {out / 'report.html'}" if report else "")
