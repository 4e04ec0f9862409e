"""The level at rest of taxels, from presses most of which leave a given taxel alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray

_UNSTEADY = 6.0
"""A taxel whose lower readings scatter so many times more than those of the others is never at rest."""


def rest_from_presses(counts: ArrayLike) -> tuple[FloatArray, float]:
    """Mean of each taxel's dark readings, and the common scatter of a dark reading.

    Dark are the readings that lie within four sigmas of the lower two thirds' median, so that the presses that leave a
    taxel alone count and those that touch it do not. A taxel that every press touches has no dark reading; its lower
    readings scatter with the force, and it is given the level of the others.

    Args:
        counts: (K, J) mean counts of presses; NaN where not read.

    Returns:
        Levels (J,) [counts], NaN for a taxel that was never read; scatter [counts], NaN where there is none.
    """
    readings = np.asarray(counts, dtype=np.float64)
    rest = np.full(readings.shape[1], np.nan)
    scatter = np.full(readings.shape[1], np.nan)
    for j, column in enumerate(readings.T):
        read = np.sort(column[np.isfinite(column)])
        if len(read) == 0:
            continue
        lower = read[: max(1, 2 * len(read) // 3)]
        middle = np.median(lower)
        sigma = max(1.5 * float(middle - np.quantile(lower, 0.16)), 0.02)
        dark = read[np.abs(read - middle) <= 4 * sigma]
        rest[j], scatter[j] = dark.mean(), dark.std()
    if not np.isfinite(scatter).any():
        return rest, float("nan")
    common = float(np.nanmedian(scatter))
    steady = scatter <= _UNSTEADY * max(common, 0.05)
    if steady.any():
        rest[np.isfinite(rest) & ~steady] = np.median(rest[steady])
    return rest, common
