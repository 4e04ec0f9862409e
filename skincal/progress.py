"""Whom to tell of what takes long: of compilation, and progress bars on standard error.

Bars are gone at the end, and there are none where it is no terminal.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

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
            bars.update(tasks[stage], completed=done, total=total)

        yield update
