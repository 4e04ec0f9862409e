"""Progress of a collecting session: presses done, force, taxels, time left."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from skincal.cli.common import say

if TYPE_CHECKING:
    from rich.console import Group
    from rich.live import Live
    from rich.text import Text

    from skincal.collect import Progress
    from skincal.dataset import SensorSpec

EVERY_S = 0.1
"""Interval between updates of the picture in the terminal [s]."""

LINE_EVERY = 10
"""Without a terminal, one line is printed per this many presses."""

FULL_COUNTS = 255.0
"""Full brightness, in counts above the start of the range, for a sensor that does not state the end of its range."""


class Told:
    """Reporter of a session on standard error: a live picture on a terminal, else a line now and then.

    Args:
        total: presses of the plan.
        sensor: its layout and range.
    """

    def __init__(self, total: int, sensor: SensorSpec) -> None:
        from rich.console import Console

        self._sensor = sensor
        self._console = Console(stderr=True)
        self._live: Live | None = None
        self._total = total
        self._began = self._drawn = time.monotonic()
        self._first: int | None = None
        self._said = -1

    def __enter__(self) -> Self:
        """Return the reporter; the picture appears with the first progress."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the picture away."""
        self.pause()

    def pause(self) -> None:
        """Take the picture away until there is something new to show."""
        if self._live is not None:
            self._live.stop()
            self._live = None

    def __call__(self, progress: Progress) -> None:
        """Report the progress of the session."""
        if self._first is None:
            self._first = progress.done
            if progress.done:
                say(f"skincal: going on after {progress.done} finished presses")
        if not self._console.is_terminal:
            self._line(progress)
            return
        now = time.monotonic()
        if now - self._drawn < EVERY_S:
            return
        self._drawn = now
        if self._live is None:
            from rich.live import Live

            self._live = Live(console=self._console, transient=True, auto_refresh=False)
            self._live.start()
        self._live.update(self._picture(progress), refresh=True)

    def left_s(self, progress: Progress) -> float:
        """Return the time that the rest takes at the present pace [s]; NaN while nothing is known."""
        done = progress.done - (self._first or 0)
        if done < 1:
            return float("nan")
        return (time.monotonic() - self._began) / done * (progress.total - progress.done)

    def _line(self, progress: Progress) -> None:
        if progress.done % LINE_EVERY or progress.done in (self._said, self._first, progress.total):
            return
        self._said = progress.done
        say(f"{progress.done} of {progress.total} presses, about {self.left_s(progress):.0f} s left")

    def _picture(self, progress: Progress) -> Group:
        from rich.console import Group
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        left = self.left_s(progress)
        planned, sample = progress.planned, progress.sample
        head = Table.grid(padding=(0, 2))
        head.add_row(
            f"press {progress.done + 1} of {progress.total}",
            ProgressBar(progress.total, progress.done, width=30),
            "" if np.isnan(left) else f"{left:.0f} s left",
        )
        force = Text(f"{progress.doing:9s} {sample.force_n:6.2f} N of {planned.force_n:.2f} N")
        return Group(head, force, taxel_image(sample.state.taxels, self._sensor))


def taxel_image(taxels: np.ndarray, sensor: SensorSpec) -> Text:
    """Return taxel values (J,) [counts] as small blocks of colour, row 0 at the bottom; a dead taxel shows a cross.

    Args:
        taxels: values, flat index r * columns + c.
        sensor: its layout and range.
    """
    from rich.text import Text

    low = sensor.value_min or 0.0
    full = FULL_COUNTS if sensor.value_max is None else sensor.value_max - low
    text = Text()
    for row in np.flipud(taxels.reshape(sensor.rows, sensor.cols)):
        for value in row:
            if np.isnan(value):
                text.append("x ", style="red")
            else:
                level = int(np.clip((value - low) / full, 0, 1) ** 0.5 * 255)
                text.append("  ", style=f"on rgb({level},{level // 2 + 40},{120 - level // 3})")
        text.append("\n")
    return text
