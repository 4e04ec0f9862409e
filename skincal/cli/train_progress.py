"""Progress of a training run: steps done, reward, tracking error, time left."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from skincal.cli.common import say

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from skincal.train import Round

LINE_EVERY_S = 60.0
"""Without a terminal, one line is printed per this time [s]."""


class Told:
    """Reporter of a run on standard error: a bar on a terminal, else a line now and then.

    Args:
        steps: total environment steps.
    """

    def __init__(self, steps: int) -> None:
        self._steps = steps
        self._bars: Progress | None = None
        self._task: TaskID | None = None
        self._began = self._said = time.monotonic()
        self._first: int | None = None

    def __enter__(self) -> Self:
        """Return the reporter; start the bar on a terminal."""
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(stderr=True)
        if console.is_terminal:
            columns = (
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.description}"),
                TimeRemainingColumn(),
            )
            self._bars = Progress(*columns, console=console, transient=True)
            self._task = self._bars.add_task("steps", total=self._steps)
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bar away."""
        if self._bars is not None:
            self._bars.stop()

    def __call__(self, row: Round) -> None:
        """Report the figures of a round."""
        if self._first is None:
            self._first = row.steps
        figures = f"reward {row.reward:.3f}, error {1e3 * row.error_m:.2f} mm"
        if self._bars is not None and self._task is not None:
            self._bars.update(self._task, completed=row.steps, description=figures)
            return
        now = time.monotonic()
        if now - self._said >= LINE_EVERY_S:
            self._said = now
            say(f"{row.steps} of {self._steps} steps, {figures}, about {self._left_s(row) / 60:.0f} min left")

    def _left_s(self, row: Round) -> float:
        done = row.steps - (self._first or 0)
        return (time.monotonic() - self._began) / max(done, 1) * (self._steps - row.steps)
