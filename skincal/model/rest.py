"""The level at rest of taxels, from presses most of which leave a given taxel alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.model.arrays import FloatArray

_UNSTEADY = 6.0
"""A taxel whose lower readings scatter so many times more than those of the others is never at rest."""

_ROUNDED = 0.01
"""Steps between readings that are larger than this part of their range are no rounding."""

_FINEST = 1e-4
"""Readings are told apart down to this part of their whole range: a numerical tolerance."""


def quantum(values: ArrayLike) -> float:
    """Return smallest step between different values (…), as rounding makes it; 0 where there is none.

    Steps below a millionth of the range are errors of arithmetic.
    """
    flat = np.unique(np.asarray(values, dtype=np.float64))
    if len(flat) < 2:
        return 0.0
    gaps = np.diff(flat)
    gaps = gaps[gaps > 1e-6 * (flat[-1] - flat[0])]
    return float(gaps.min()) if len(gaps) else 0.0


@dataclass(frozen=True, eq=False)
class RestLevels:
    """Levels of taxels at rest, from presses that leave them alone.

    Attributes:
        level: (J,) [counts]; NaN for a taxel that was never read.
        known: (J,) True if the taxel was seen at rest; else its level is the median of the others.
        scatter: of one reading at rest [counts]; NaN where there is none.
    """

    level: FloatArray
    known: NDArray[np.bool_]
    scatter: float


def levels_from_presses(counts: ArrayLike) -> RestLevels:
    """Estimate the level of each taxel at rest, and the scatter of a reading at rest.

    Dark are the readings that lie within four sigmas of the lower two thirds' median, so that the presses that leave a
    taxel alone count and those that touch it do not. A taxel that every press touches has no dark reading; its lower
    readings scatter with the force, and it is given the level of the others.

    Args:
        counts: (K, J) mean counts of presses; NaN where not read.
    """
    readings = np.asarray(counts, dtype=np.float64)
    rest = np.full(readings.shape[1], np.nan)
    scatter = np.full(readings.shape[1], np.nan)
    finite = readings[np.isfinite(readings)]
    span = float(np.ptp(finite)) if finite.size else 0.0
    finest = max(_FINEST * span, min(0.5 * quantum(finite), _ROUNDED * span))
    for j, column in enumerate(readings.T):
        read = np.sort(column[np.isfinite(column)])
        if len(read) == 0:
            continue
        lower = read[: max(1, 2 * len(read) // 3)]
        middle = np.median(lower)
        sigma = max(1.5 * float(middle - np.quantile(lower, 0.16)), finest)
        dark = read[np.abs(read - middle) <= 4 * sigma]
        rest[j], scatter[j] = dark.mean(), dark.std()
    read = np.isfinite(rest)
    if not np.isfinite(scatter).any():
        return RestLevels(rest, np.zeros(len(rest), dtype=bool), float("nan"))
    common = float(np.nanmedian(scatter))
    steady = read & (np.nan_to_num(scatter, nan=np.inf) <= _UNSTEADY * max(common, finest))
    if steady.any():
        rest[read & ~steady] = np.median(rest[steady])
    return RestLevels(rest, steady, common)


def rest_from_presses(counts: ArrayLike) -> tuple[FloatArray, float]:
    """Return levels at rest (J,) [counts] and the scatter of a reading there; see :func:`levels_from_presses`."""
    found = levels_from_presses(counts)
    return found.level, found.scatter
