"""Whom to tell of what takes long: of compilation, and progress on standard error.

Bars and stages are gone at the end; where it is no terminal, each stage is a line as it begins.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from skincal.errors import readable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID

on_compile: Callable[[], None] | None = None
"""Called once in a process before the skin model is compiled, which takes seconds; not where the cache has it."""

NOTE = "skincal: compiling the skin model or the fit, once on this machine (about 15 s)"


def console() -> Console:
    """Return the terminal of all progress, standard error; where it is none, ``is_terminal`` is False."""
    from rich.console import Console

    return Console(stderr=True)


@contextmanager
def progress() -> Generator[Progress]:
    """Yield the bars; add tasks to them."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    terminal = console()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    shown = terminal.is_terminal or terminal.is_jupyter
    with Progress(*columns, console=terminal, transient=True, disable=not shown) as bars:
        yield bars


@contextmanager
def stage_bars() -> Generator[Callable[[str, int, int], None]]:
    """Yield a callback of a stage, how much of it is done, and of how much."""
    with progress() as bars:
        tasks: dict[str, TaskID] = {}

        def update(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
                if bars.disable:
                    _print_stage(stage)
            bars.update(tasks[stage], completed=done, total=total)

        yield update


@contextmanager
def stage_shown() -> Generator[Callable[[str], None]]:
    """Yield a callback that shows the stage and the elapsed time."""
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    terminal = console()
    if not terminal.is_terminal:
        yield _print_stage
        return
    # Truncate a long stage name, not the time.
    stage = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, ratio=1))
    columns = SpinnerColumn(), TimeElapsedColumn(table_column=Column(min_width=7)), stage
    with Progress(*columns, console=terminal, transient=True, expand=True) as shown:
        task = shown.add_task("reading", total=None)
        yield lambda name: shown.update(task, description=name)


def _print_stage(stage: str) -> None:
    with suppress(OSError):
        print(readable(stage), file=sys.stderr, flush=True)
