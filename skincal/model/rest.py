"""The rest level of taxels, estimated from presses, most of which do not touch a given taxel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.model.arrays import FloatArray

_UNSTEADY = 6.0
"""Scatter of a taxel's rest readings over the median of all taxels, above which the taxel is never at rest."""

_ROUNDED = 0.01
"""Largest rounding step of readings, as a fraction of their range."""

_FINEST = 1e-4
"""Smallest resolved difference of readings, as a fraction of their range: a numerical tolerance."""


_EVIDENCE = 10.0
"""Log-likelihood ratio [nats] of clipped noise over evenly spread signals, above which noise counts as clipped."""

_FINE = 4.0
"""Smallest noise, in rounding steps, that has the shape of a half normal distribution; below, the steps dominate."""

_NOISY = 0.25
"""Smallest number of noise readings above the bound over readings on it, if the bound clips half of the noise."""


def rounding_step(values: ArrayLike) -> float:
    """Return the smallest step between different values of any shape: the rounding step; 0 if all are equal.

    Steps below a millionth of the range count as rounding errors of the arithmetic.
    """
    flat = np.unique(np.asarray(values, dtype=np.float64))
    if len(flat) < 2:
        return 0.0
    gaps = np.diff(flat)
    gaps = gaps[gaps > 1e-6 * (flat[-1] - flat[0])]
    return float(gaps.min()) if len(gaps) else 0.0


@dataclass(frozen=True, eq=False)
class RestLevels:
    """Rest levels of taxels, from presses that do not touch them.

    Attributes:
        level: (J,) rest level [counts]; NaN for a taxel that was never read.
        known: (J,) True if the taxel was read at rest; otherwise its level is the median of the others.
        scatter: standard deviation of one reading at rest, median over the taxels [counts]; NaN without readings.
        scatters: (J,) standard deviation of each taxel [counts].
        dark: (J,) number of readings at rest.
    """

    level: FloatArray
    known: NDArray[np.bool_]
    scatter: float
    scatters: FloatArray
    dark: NDArray[np.intp]


def levels_from_presses(counts: ArrayLike) -> RestLevels:
    """Estimate the rest level of each taxel, and the scatter of a reading at rest.

    A reading is at rest ("dark") if it lies within four sigmas of the median of the lower two thirds. This keeps the
    presses that do not touch the taxel. If the converter's lower bound clips half of the noise, sigma comes from the
    upper half (:func:`half_scatter`). A taxel that every press touches has no reading at rest: its lower readings
    scatter with the force, and it gets the median level of the others.

    Args:
        counts: (K, J) mean counts of presses; NaN where not read.
    """
    readings = np.asarray(counts, dtype=np.float64)
    rest = np.full(readings.shape[1], np.nan)
    scatter, number = np.full(readings.shape[1], np.nan), np.zeros(readings.shape[1], dtype=np.intp)
    finite = readings[np.isfinite(readings)]
    span = float(np.ptp(finite)) if finite.size else 0.0
    step = rounding_step(finite)
    finest = max(_FINEST * span, min(0.5 * step, _ROUNDED * span))
    for j, column in enumerate(readings.T):
        read = np.sort(column[np.isfinite(column)])
        if len(read) == 0:
            continue
        lower = read[: max(1, 2 * len(read) // 3)]
        middle = np.median(lower)
        edge = float(np.quantile(lower, 0.16))
        sigma = max(1.5 * float(middle - edge), finest)
        if edge == read[0] and (half := half_scatter(read, finest)) > _FINE * step:
            sigma = max(sigma, half)
        dark = read[np.abs(read - middle) <= 4 * sigma]
        rest[j], scatter[j], number[j] = dark.mean(), dark.std(), len(dark)
    read = np.isfinite(rest)
    if not np.isfinite(scatter).any():
        return RestLevels(rest, np.zeros(len(rest), dtype=bool), float("nan"), scatter, number)
    common = float(np.nanmedian(scatter))
    steady = read & (np.nan_to_num(scatter, nan=np.inf) <= _UNSTEADY * max(common, finest))
    if steady.any():
        rest[read & ~steady] = np.median(rest[steady])
    return RestLevels(rest, steady, common, scatter, number)


def half_scatter(readings: FloatArray, finest: float) -> float:
    """Return the standard deviation of noise whose lower half is clipped; 0 if low readings are not clipped noise.

    Readings above the lowest one are modelled as a mixture of a half normal distribution (noise) and a uniform one
    (signals), fitted by expectation-maximisation.

    Args:
        readings: (n,) readings of one taxel [counts].
        finest: lower bound of the standard deviation [counts].
    """
    above = readings[readings > readings.min()] - readings.min()
    on_bound, top = len(readings) - len(above), float(above.max(initial=0.0))
    if len(above) < 2 or top <= finest:
        return 0.0
    part, sigma = 0.5, max(float(np.median(above[: max(2, on_bound)])), finest)
    half = np.zeros_like(above)
    for _ in range(60):
        half = part * np.sqrt(2 / np.pi) / sigma * np.exp(-0.5 * (above / sigma) ** 2)
        chance = half / (half + (1 - part) / top)
        part = float(np.clip(chance.mean(), 1e-3, 1 - 1e-3))
        sigma = max(float(np.sqrt(chance @ above**2 / max(float(chance.sum()), 1e-12))), finest)
    gain = float(np.log(half * top + 1 - part).sum())
    return sigma if gain > _EVIDENCE and part * len(above) > _NOISY * on_bound else 0.0


def rest_from_presses(counts: ArrayLike) -> tuple[FloatArray, float]:
    """Return rest levels (J,) and the scatter of a reading at rest [counts]; see :func:`levels_from_presses`."""
    found = levels_from_presses(counts)
    return found.level, found.scatter
