"""What the verbs share: options, JSON on standard output, messages and progress on standard error."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.errors import Problem

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

DatasetArgument = Annotated[
    Path, typer.Argument(metavar="DATASET", help="Folder of a dataset.", show_default=False)
]
OutOption = Annotated[
    Path, typer.Option("--out", help="Where to write; made whole or not at all.", show_default=False)
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on standard output and nothing else there.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace an earlier output of skincal.")]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, help="Seed of all randomness; the same seed, the same result.")
]


def example(*commands: str) -> str:
    """The end of a verb's help: what a person types."""
    # The first line tells click to keep the lines as they are.
    return "\b\nExample:\n" + "\n".join(f"  {command}" for command in commands)


def print_json(content: Mapping[str, Any]) -> None:
    """Prints one JSON object on standard output; what JSON has no number for (NaN, inf) becomes null."""
    typer.echo(json.dumps(plain(content), allow_nan=False))


def plain(value: Any) -> Any:
    """A value as JSON has it: arrays as lists, paths as text, NaN and inf as null."""
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
    """Prints a message on standard error, if anybody can read it: a terminal may be gone."""
    with suppress(OSError):
        typer.echo(message, err=True)


def warn(problems: Iterable[Problem]) -> None:
    """Prints warnings on standard error."""
    for problem in problems:
        say(f"skincal: warning: {problem}")


@contextmanager
def progress() -> Generator[Progress]:
    """Progress bars on standard error, which vanish at the end; nothing is drawn where it is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        yield bars


@contextmanager
def stage_bars() -> Generator[Callable[[str, int, int], None]]:
    """Progress bars, one a stage, as a function that is told the stage, how much is done, and of how much."""
    with progress() as bars:
        tasks: dict[str, TaskID] = {}

        def told(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield told
