"""Spikes: readings of a series that jump and return within one sample, because a taxel dropped out."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from skincal.imports.recording import BoolArray, Cut, FloatArray, runs
from skincal.model.rest import rounding_step

TIMES: Final = 10.0
"""Least jump of a spike, in standard deviations of the noise of its stretch and of the taxel; chance makes none."""

STEPS: Final = 2.5
"""Least jump in steps of the converter: coarse readings jump by one step although their noise looks like zero."""

MOST: Final = 0.05
"""Largest part of readings that may be spikes; more are taken for the signal (set by eye)."""

LEAST: Final = 4
"""Smallest number of differences from which the noise of a stretch is estimated."""

PART, SIGMAS = 0.8, 1.2816
"""Quantile of absolute differences that gives the noise, and its value for a standard normal."""


def find_spikes(counts: FloatArray, cut: Cut) -> BoolArray:
    """Find the readings (M, J) that jump and return within one sample; none if there are too many.

    The noise is estimated in each phase of a press and each stretch of rest.

    Args:
        counts: (M, J) samples; NaN where not read.
        cut: presses of the series.
    """
    spikes, looked = np.zeros(counts.shape, dtype=bool), 0
    if len(counts) <= LEAST:
        return spikes
    idle = np.ones(len(counts), dtype=bool)
    for one in (*cut.spans, *cut.rejected):
        idle[one.start : one.stop] = False
    least = STEPS * rounding_step(counts[np.isfinite(counts)])
    usual = _noise(np.diff(counts, axis=0))
    edges = [(span.start, span.hold, span.hold_stop, span.stop) for span in cut.spans]
    for start, end in (*(ends for four in edges for ends in pairwise(four)), *runs(idle)):
        first, stop = max(start - 1, 0), min(end + 1, len(counts))
        part = counts[first:stop, alive := np.isfinite(counts[first:stop]).any(axis=0)]
        steps = np.diff(part, axis=0)
        if len(steps) < LEAST:
            continue
        looked += steps[1:].size
        limit = np.maximum(TIMES * np.maximum(_noise(steps), usual[alive]), least)
        before, after = steps[:-1], steps[1:]
        far = np.minimum(np.abs(before), np.abs(after))
        far = np.minimum(far, np.abs(part[1:-1] - np.nanmedian(part, axis=0)))
        spikes[first + 1 : stop - 1, alive] |= (np.sign(before) == -np.sign(after)) & (far > limit)
    return spikes if spikes.sum() <= MOST * looked else np.zeros_like(spikes)


def _noise(steps: FloatArray) -> FloatArray:
    """Estimate the noise of each taxel (J,) from differences (n, J) of successive readings."""
    return np.quantile(np.abs(np.nan_to_num(steps)), PART, axis=0) / (np.sqrt(2) * SIGMAS)
