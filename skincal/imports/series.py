"""A time series, and the spans of it that are presses. Pure numerics; the cutters find the spans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.imports.recording import Column, FloatArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Series:
    """Input of a cutter.

    Attributes:
        time_s: session clock [s], ascending, shape (M,).
        force_n: normal force [N], finite, shape (M,).
        part: index of the file, shape (M,); no press extends over two files.
        press: number of the press, -1 for none, shape (M,); None without such a column.
        phase: words of a column of phases, shape (M,); None without such a column.
    """

    time_s: FloatArray
    force_n: FloatArray
    part: IntArray
    press: IntArray | None = None
    phase: Column | None = None

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True)
class Span:
    """A press in a series, as indices; ``stop`` and ``hold_stop`` are one past the last.

    Attributes:
        number: number of the press.
        start: first sample of the contact, or of the ramp that leads to a plateau.
        hold: first sample of the hold.
        hold_stop: end of the hold.
        stop: end of the contact.
        rising: whether the force rises before the hold, which is then loading.
        branch: ``up`` or ``down`` for a plateau; '' for a single press.
    """

    number: int
    start: int
    hold: int
    hold_stop: int
    stop: int
    rising: bool = True
    branch: str = ""


@dataclass(frozen=True)
class Rejected:
    """A span that is not a press, with the reason; its samples are left out."""

    start: int
    stop: int
    why: str


@dataclass(frozen=True)
class Cut:
    """Result of a cutter."""

    spans: tuple[Span, ...]
    rejected: tuple[Rejected, ...] = ()


def runs(mask: BoolArray, part: IntArray | None = None) -> list[tuple[int, int]]:
    """Return the stretches ``[start, stop)`` where a mask holds; a change of ``part`` ends a stretch."""
    if not mask.any():
        return []
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if part is None:
        return list(zip(starts.tolist(), stops.tolist(), strict=True))
    breaks = np.flatnonzero(np.diff(part)) + 1
    found: list[tuple[int, int]] = []
    for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
        inside = [int(b) for b in breaks[(breaks > start) & (breaks < stop)]]
        ends = [start, *inside, stop]
        found += [(ends[i], ends[i + 1]) for i in range(len(ends) - 1)]
    return found


def longest(stretches: Sequence[tuple[int, int]], time_s: FloatArray) -> tuple[int, int] | None:
    """Return the stretch that lasts longest, the first if there are several."""
    if not stretches:
        return None
    return max(stretches, key=lambda run: float(time_s[run[1] - 1] - time_s[run[0]]))
