"""Repair of stamps into one ascending clock: wraps, equal stamps and missing stamps. Pure numerics.

The rows of a file are taken in their order: it is the order of events, and the stamps may be wrong.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from skincal.imports.mapping_file import Resampling
from skincal.imports.recording import BoolArray, Column, FloatArray, IntArray

BITS: Final = (8, 16, 24, 32)
"""Usual widths of counters [bit]."""

RARE_BITS: Final = (10, 12, 14, 15, 20, 28, 30, 31, 48)
"""Other widths that are tried."""

DIGITS: Final = range(3, 13)
"""Numbers of decimal digits after which a counter may begin again, tried as rare periods."""

DAY_S: Final = 86400.0
CLOCK_PERIODS_S: Final = {"24 h": DAY_S, "12 h": DAY_S / 2}

RARE_PERIODS_S: Final = {"7 days": 7 * DAY_S, "60 min": 3600.0, "60 s": 60.0, "1 s": 1.0}
"""Periods of clocks that give a part of the time."""

LARGEST_STEP: Final = 20.0
"""A wrap is accepted if the step it leaves is at most this many usual steps (a tolerance), or this part of it:"""

SMALL_PART: Final = 0.02

PAUSES: Final = 2.0
"""Or this many of the longest pauses elsewhere in the recording."""

RARE_STEP: Final = 3.0
"""Of the rare periods, the step may be this many usual ones: a restart then seldom looks like their wrap."""

EPOCH_S: Final = (9.46e8, 4.1e9)
"""Seconds since 1970 of the years 2000 and 2100, which bound today's stamps."""

DISPLACED: Final = 20
"""Rows at most this many places from the order of their stamps were written late; farther, the clock was set."""


@dataclass(frozen=True)
class Wraps:
    """The wraps of a clock.

    Its ``period`` is in the unit of the stamps, ``words`` name the kind of clock with this period ('' if it was given),
    and ``turns`` (n,) count the wraps up to each row.
    """

    period: float
    words: str
    turns: IntArray

    @property
    def rows(self) -> IntArray:
        """The first rows of each turn."""
        return np.flatnonzero(
            np.diff(np.maximum.accumulate(self.turns), prepend=self.turns.min(initial=0)) > 0
        )


def wraps_of(stamps: FloatArray, period: float, words: str = "") -> Wraps:
    """Return the wraps of a clock of known period: its falls by more than half of it.

    A rise by as much beside a fall takes the wrap back: a row from before the wrap was written after it, or a single
    stamp is wrong. Any other rise is a pause, and other falls are no wraps. Stamps (n,) are NaN where missing.
    """
    given = np.flatnonzero(np.isfinite(stamps))
    steps = np.diff(stamps[given], prepend=stamps[given[:1]])
    falls = np.concatenate([[0], np.cumsum(steps < -period / 2)])
    at = np.arange(len(given))
    beside = falls[np.minimum(at + DISPLACED + 1, len(given))] > falls[np.maximum(at - DISPLACED, 0)]
    turns = np.zeros(len(stamps), dtype=np.int64)
    turns[given] = np.diff(falls) - ((steps > period / 2) & beside)
    return Wraps(period, words, np.cumsum(turns))


def find_wraps(stamps: FloatArray, unit_s: float) -> Wraps | None:
    """Return the wraps that explain the large steps back of a clock; None without such steps or such a period.

    A counter has wrapped if adding its period turns the step back into a small step forward, or, for a counter of usual
    width, into a pause like those elsewhere in the recording. Of several such periods, the one with the smallest steps
    is chosen. Steps back by less than half a period are none of its wraps. Stamps (n,) are in the order of the rows,
    NaN where missing; their unit is ``unit_s`` [s].
    """
    steps = np.diff(stamps[np.isfinite(stamps)])
    if not (steps < 0).any():
        return None
    usual = usual_step(stamps)
    span = float(np.nanmax(stamps) - np.nanmin(stamps))
    found: list[tuple[float, float, str]] = []
    for words, period, rare in _periods(unit_s):
        wraps = steps < -period / 2
        # A clock shows nothing beyond its period, and falls back by most of it.
        if span >= period or not wraps.any():
            continue
        step = period + float(steps[wraps].max())
        pause = float(steps[steps <= period / 2].max())
        usually = max(LARGEST_STEP * usual, SMALL_PART * period, PAUSES * pause)
        if step <= (RARE_STEP * usual if rare else usually):
            found.append((step, period, words))
    if not found:
        return None
    _, period, words = min(found, key=lambda one: one[0])
    return wraps_of(stamps, period, words)


def unwrapped(stamps: FloatArray, wraps: Wraps) -> FloatArray:
    """Return the stamps with the period added for every turn."""
    return stamps + wraps.period * wraps.turns


def in_order(stamps: FloatArray) -> BoolArray:
    """Return which stamps (n,), all given, belong to a longest part that does not fall; the others are out of order."""
    tops: list[float] = []  # the lowest last stamp of a part of each length, and its row
    rows: list[int] = []
    before: list[int] = []
    for row, stamp in enumerate(stamps.tolist()):
        at = bisect_right(tops, stamp)
        before.append(rows[at - 1] if at else -1)
        tops[at : at + 1], rows[at : at + 1] = [stamp], [row]
    kept, row = np.zeros(len(stamps), dtype=bool), rows[-1] if rows else -1
    while row >= 0:
        kept[row], row = True, before[row]
    return kept


def usual_step(stamps: FloatArray) -> float:
    """Return the median positive step from row to row; 0 without one."""
    given = np.flatnonzero(np.isfinite(stamps))
    steps = np.diff(stamps[given]) / np.diff(given)
    steps = steps[steps > 0]
    return float(np.median(steps)) if steps.size else 0.0


def with_missing(stamps: FloatArray) -> FloatArray:
    """Return the stamps with missing ones placed evenly between their neighbours, shape (n,).

    Before the first and after the last known stamp they continue at the usual step.
    """
    given = np.flatnonzero(np.isfinite(stamps))
    if given.size in (0, len(stamps)):
        return stamps
    rows = np.arange(len(stamps))
    filled = np.interp(rows, given, stamps[given])
    step = usual_step(stamps)
    filled[: given[0]] -= step * (given[0] - rows[: given[0]])
    filled[given[-1] + 1 :] += step * (rows[given[-1] + 1 :] - given[-1])
    return filled


def spread_equal(time: FloatArray) -> FloatArray:
    """Return ascending times with rows of equal stamps spread evenly up to the next stamp, shape (n,).

    Clocks of whole seconds, and rows that arrive in packets, give several rows the same stamp. A packet before a gap
    is spread over no more time than its rows take at the mean rate.
    """
    first = np.flatnonzero(np.concatenate([[True], np.diff(time) != 0]))
    size = np.diff(np.append(first, len(time)))
    if not (size > 1).any():
        return time
    step = np.append(np.diff(time[first]), np.inf)
    rate_step = (time[-1] - time[0]) / max(len(time) - size[-1], 1)
    each = np.minimum(step / size, rate_step)
    within = np.arange(len(time)) - np.repeat(first, size)
    return time + within * np.repeat(each, size)


def epoch_unit(stamps: FloatArray, factors: Mapping[str, float]) -> str | None:
    """Return the unit, of names and lengths [s], in which stamps (n,) are times since 1970 in this century, or None."""
    middle = float(np.nanmedian(stamps)) if np.isfinite(stamps).any() else 0.0
    return next((name for name, factor in factors.items() if EPOCH_S[0] < middle * factor < EPOCH_S[1]), None)


def _periods(unit_s: float) -> list[tuple[str, float, bool]]:
    """Return the kinds of clocks, their periods in the unit of the stamps, and whether they are rare."""
    counters = [
        (f"a counter of {bits} bits" + (f" divided by {divided}" if divided > 1 else ""), 2.0**bits / divided,
         bits in RARE_BITS)
        for bits in (*BITS, *RARE_BITS)
        for divided in (1, 1000, 1_000_000)
    ]  # fmt: skip
    decimal = [(f"a counter of {digits} decimal digits", 10.0**digits, True) for digits in DIGITS]
    clocks = [
        (f"a clock of {words}", period / unit_s, words in RARE_PERIODS_S)
        for words, period in (CLOCK_PERIODS_S | RARE_PERIODS_S).items()
    ]
    return counters + decimal + clocks


def resampled(
    time_s: FloatArray, values: Column, onto_s: FloatArray, resample: Resampling, max_age_s: float
) -> Column:
    """Return a stream resampled at other times (M,); NaN, or '' for words, where the stream has no valid sample.

    ``previous`` takes the last sample that is not later, as for all words; ``linear`` interpolates between the last and
    the next sample, and needs both. The stream's times (n,) are ascending [s], its values (n,) numbers, or words as
    objects. A sample older than ``max_age_s``, or two that are farther apart, give NaN.
    """
    missing = "" if values.dtype == object else np.nan
    if not len(time_s):
        return np.full(len(onto_s), missing, dtype=values.dtype)
    before = np.searchsorted(time_s, onto_s, side="right") - 1
    first = np.maximum(before, 0)
    if resample == "previous" or values.dtype == object:
        return np.where((before >= 0) & (onto_s - time_s[first] <= max_age_s), values[first], missing)
    exact = (before >= 0) & (time_s[first] == onto_s)
    after = np.minimum(np.where(exact, first, before + 1), len(time_s) - 1)
    span = time_s[after] - time_s[first]
    good = (before >= 0) & (exact | ((before + 1 < len(time_s)) & (span <= max_age_s)))
    share = np.divide(onto_s - time_s[first], span, out=np.zeros(len(onto_s)), where=span > 0)
    return np.where(good, values[first] + share * (values[after] - values[first]), np.nan)
