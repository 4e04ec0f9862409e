"""How much of the gap is gone, on presses that neither the fit nor the choice has seen.

Before and after are compared on the same frames, with measured counts as they are and predictions as the converter
would show them on average. A press may place itself within its slack, alike before and after. The floor is the noise of
the frames at the values that are predicted. An interval comes from drawing whole presses again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.gap.hypothesis import Hypothesis
from skincal.gap.reading import Reading
from skincal.inference.session import GapSession
from skincal.model.arrays import BoolArray, FloatArray, IntArray

_DRAWS = 400
FEWEST = 4
"""Presses without which nothing is sure: an interval that draws from fewer is too narrow."""
FAR_WORSE = 1.5
"""What makes the error so many times as large is refuted, whichever presses it is that show it."""
OPEN = ((0.1, 0.3), (0.6, 2.0))
"""What was named does not explain a gap of which surely less than this part is closed, if the gap is at least so many
times the noise: next to nothing of any gap, or too little of a large one, as gains of taxels do where gains drift."""


@dataclass(frozen=True, eq=False)
class Gap:
    """The gap on presses nobody has fitted.

    Attributes:
        before: root mean square error of a taxel with the base model [counts].
        after: with the named effects [counts].
        floor: noise alone [counts].
        closed: (before² - after²) / (before² - floor²); NaN where there is no gap.
        interval: where ``closed`` lies, 95 %.
        added: where after² - before² lies, 95 % [counts²].
        presses: number of presses looked at of which something was read.
        frames: number of frames, or of hold means.
        slack_before_m: root mean square of what presses had to move [m].
        slack_after_m: with the named effects [m].
        errors: (presses, 4) sums of squares before, after and of the floor, and their number, press by press.
    """

    before: float
    after: float
    floor: float
    closed: float
    interval: tuple[float, float]
    added: tuple[float, float]
    presses: int
    frames: int
    slack_before_m: float
    slack_after_m: float
    errors: FloatArray

    def refutes(self, least: float) -> bool:
        """Whether presses are surely further off after than before, or some of them by far.

        Drawing presses again does not make sure of what a single one shows, as one draw in three lacks it; but noise
        makes none that much worse.

        Args:
            least: root mean square of what is added, in units of the noise.
        """
        added = self.after**2 - self.before**2
        sure = self.presses >= FEWEST and (self.added[0] > 0 or self.after > FAR_WORSE * self.before)
        return bool(sure and added > (least * self.floor) ** 2)

    def stays_open(self, law: float = 0.0) -> bool:
        """Whether what was named surely does not explain the gap (:data:`OPEN`).

        Args:
            law: root mean square of what the contact law is not right in, in units of the noise.
        """
        return any(self.leaves_open(most, least, law) for most, least in OPEN)

    def leaves_open(self, most: float, least: float, law: float = 0.0) -> bool:
        """Whether there is a gap beside the contact law's of which surely next to nothing is closed.

        Args:
            most: part of it that is closed at most.
            least: root mean square of it, in units of the noise.
            law: root mean square of what the contact law is not right in, in units of the noise. No effect closes it.
        """
        gap = self.before**2 - self.floor**2
        there = gap - (law * self.floor) ** 2
        sure = self.presses >= FEWEST and self.interval[1] * gap < most * there
        return bool(sure and there > (least * self.floor) ** 2)


def gap_closed(
    before: Hypothesis,
    after: Hypothesis,
    session: GapSession,
    reading: Reading,
    rows: BoolArray,
    rng: np.random.Generator,
) -> Gap:
    """The gap before and after.

    Args:
        before: the base model, places of the held-out presses found.
        after: the same with effects.
        session: at full rate: one observation a frame, or a hold mean.
        reading: of it.
        rows: (N,) observations that are looked at.
        rng: for the interval.
    """
    ends = [hypothesis.values(session) for hypothesis in (before, after)]
    # A press beyond the rim of a mesh has no image.
    seen = reading.seen & rows[:, None] & np.isfinite(ends[0]) & np.isfinite(ends[1])
    first, second = (np.where(seen, reading.counts - reading.expected(v), 0.0) ** 2 for v in ends)
    noise = np.where(seen, reading.deviation(ends[1]) ** 2, 0.0)
    presses = np.unique(session.press[rows])
    sums = np.array(
        [[part[own].sum() for part in (first, second, noise, seen)] for own in _owned(session, rows, presses)]
    ).reshape(-1, 4)
    # A press of which nothing was read says nothing: drawn in place of one that was, it would only look sure.
    read = sums[:, 3] > 0
    presses, sums = (presses[read], sums[read]) if read.any() else (presses, sums)
    total = sums.sum(axis=0)
    drawn = rng.integers(0, len(presses), (_DRAWS, len(presses)))
    again = sums[drawn].sum(axis=1)
    none = np.full(len(again), np.nan)
    slack = [np.sqrt((h.places[presses, :2] ** 2).sum(axis=1).mean()) for h in (before, after)]
    rms = np.sqrt(total[:3] / total[3]).tolist()
    return Gap(
        rms[0],
        rms[1],
        rms[2],
        float(_closed(total[None])[0]),
        _interval(_closed(again)),
        _interval(np.divide(again[:, 1] - again[:, 0], again[:, 3], out=none, where=again[:, 3] > 0)),
        len(presses),
        int(rows.sum()),
        float(slack[0]),
        float(slack[1]),
        sums,
    )


def _owned(session: GapSession, rows: BoolArray, presses: IntArray) -> list[IntArray]:
    return [np.flatnonzero(rows & (session.press == press)) for press in presses]


def _interval(drawn: FloatArray) -> tuple[float, float]:
    """Where 95 % of what was drawn (D,) lies; NaN where that is a number in none."""
    some = drawn[np.isfinite(drawn)]
    if not len(some):
        return float("nan"), float("nan")
    return float(np.quantile(some, 0.025)), float(np.quantile(some, 0.975))


def _closed(sums: FloatArray) -> FloatArray:
    """(before - after) / (before - floor) for rows of sums (n, 4)."""
    gap = sums[:, 0] - sums[:, 2]
    return np.where(gap > 0, (sums[:, 0] - sums[:, 1]) / np.where(gap > 0, gap, 1.0), np.nan)
