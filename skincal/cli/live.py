"""Progress of a hand and of a training run on the terminal: a live picture, or a line now and then."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Any, Self

from skincal.cli.terminal import say
from skincal.progress import console, progress

if TYPE_CHECKING:
    import numpy as np
    from rich.live import Live
    from rich.text import Text

    from skincal.collect import Progress
    from skincal.dataset import SensorSpec
    from skincal.hand.driver import HandState
    from skincal.train import Round

EVERY_S = 0.1
"""Interval between updates of the picture in the terminal [s]."""

LINE_EVERY = 10
"""Without a terminal, one line is printed per this many presses."""

LINE_EVERY_S = 60.0
"""Without a terminal, one line of a training run is printed per this time [s]."""

FULL_COUNTS = 255.0
"""Full brightness, in counts above the start of the range, for a sensor that does not state the end of its range."""


class _Live(AbstractContextManager["_Live"]):
    """A picture on standard error that is updated now and then; none without a terminal."""

    def __init__(self, sensor: SensorSpec) -> None:
        self._sensor = sensor
        self._console = console()
        self._is_terminal = self._console.is_terminal
        self._live: Live | None = None
        self._began = self._drawn = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.pause()

    def pause(self) -> None:
        """Take the picture away until there is something new to show."""
        if self._live is not None:
            self._live.stop()
            self._live = None

    def _show(self, *parts: Any) -> None:
        from rich.console import Group
        from rich.live import Live

        if self._live is None:
            self._live = Live(console=self._console, transient=True, auto_refresh=False)
            self._live.start()
        self._live.update(Group(*parts), refresh=True)

    def _due(self) -> bool:
        """Return whether the picture is old enough for a new one."""
        now = time.monotonic()
        if now - self._drawn < EVERY_S:
            return False
        self._drawn = now
        return True


class SessionProgress(_Live):
    """Reporter of a collecting session."""

    _first: int | None = None
    _last_line = -1

    def __call__(self, progress: Progress) -> None:
        """Report the progress of the session."""
        done, total = progress.done, progress.total
        if self._first is None:
            self._first = done
            if done:
                say(f"skincal: going on after {done} finished presses")
        new = done - self._first
        left = f"{(time.monotonic() - self._began) / new * (total - done):.0f} s left" if new else ""
        if not self._is_terminal:
            if not (done % LINE_EVERY or done in (self._last_line, self._first, total)):
                self._last_line = done
                say(f"{done} of {total} presses, about {left}")
            return
        if not self._due():
            return
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        head = Table.grid(padding=(0, 2))
        head.add_row(f"press {done + 1} of {total}", ProgressBar(total, done, width=30), left)
        force = f"{progress.doing:9s} {progress.sample.force_n:6.2f} N of {progress.planned.force_n:.2f} N"
        self._show(head, Text(force), taxel_image(progress.sample.state.taxels, self._sensor))


class RunProgress(_Live):
    """Reporter of a policy's run on a hand."""

    _stage = ""

    def __call__(self, state: HandState, stage: str) -> None:
        """Report a state of the hand."""
        from rich.text import Text

        if not self._is_terminal:
            if stage != self._stage:
                say(f"{state.time_s:7.2f} s  {stage}")
            self._stage = stage
        elif self._due():
            self._show(Text(f"{stage:12s} {state.time_s:7.2f} s"), taxel_image(state.taxels, self._sensor))


@contextmanager
def training_shown(steps: int) -> Generator[Callable[[Round], None]]:
    """Yield a callback of the rounds of a training run: it shows a bar, or without a terminal a line now and then."""
    began = printed = time.monotonic()
    first: int | None = None
    with progress() as bars:
        task = bars.add_task("", total=steps)

        def report(row: Round) -> None:
            nonlocal first, printed
            figures, now = f"reward {row.reward:.3f}, error {1e3 * row.error_m:.2f} mm", time.monotonic()
            if first is None:
                # Steps of an earlier run do not count for the time left.
                first = row.steps
                bars.reset(task, completed=first)
            bars.update(task, completed=row.steps, description=figures)
            if bars.disable and now - printed >= LINE_EVERY_S:
                printed = now
                left_min = (now - began) / max(row.steps - first, 1) * (steps - row.steps) / 60
                say(f"{row.steps} of {steps} steps, {figures}, about {left_min:.0f} min left")

        yield report


def taxel_image(taxels: np.ndarray, sensor: SensorSpec) -> Text:
    """Return taxel values (J,) [counts] as small blocks of colour, row 0 at the bottom; a dead taxel shows a cross."""
    import numpy as np
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
