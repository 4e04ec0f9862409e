"""Parts shared by the verbs: options, JSON on standard output, messages on standard error."""

from __future__ import annotations

import json
import math
import os
import re
import sys
from collections.abc import Generator, Iterable, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer

from skincal.errors import Problem

DatasetArgument = Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of a dataset.")]
CalibrationArgument = Annotated[Path, typer.Argument(metavar="CAL", help="Folder of a calibration.")]
OutOption = Annotated[
    Path,
    typer.Option("--out", help="Folder to write; it appears complete or not at all."),
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object, and nothing else, on standard output.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace an earlier output of skincal.")]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, help="Seed of all randomness; the same seed gives the same result.")
]

WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", min=1, max=1024, help="Number of processes.", show_default="one per core"),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Use the workers of a Dask cluster, tcp://HOST:8786, instead of processes on this machine.",
    ),
]


def example(*commands: str) -> str:
    """Return the epilog of a verb's help: commands as a person types them."""
    # The first line tells click to keep the line breaks.
    return "\b\nExample:\n" + "\n".join(f"  {command}" for command in commands)


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
    """Print a message on standard error; do nothing where the terminal is gone.

    It may hold names and texts of files, so control characters, which terminals obey, are shown as codes.
    """
    with suppress(OSError):
        typer.echo(_CONTROL.sub(lambda found: f"\\x{ord(found[0]):02x}", message), err=True)


_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


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
