"""The scale of each taxel under uniform pressure.

A pressure that is the same everywhere gives taxel j the load F phi_j whatever pose and elasticity are, so that of the
skin model only

    D_kj = S_j F_k phi_j

is left: a straight line for each taxel, whose slope is found by least squares in which values far off count less
(Huber's weights, Ann. Math. Stat. 35 (1964) 73). Where there are presses enough the line need not meet the origin, so
that neither the zero of a pressure gauge nor a level that jumps is taken for a scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.fitting.observe import TO_SIGMA
from skincal.fitting.types import Bools, Floats

_HUBER = 1.345
_ROUNDS = 30
_FREE = 5
"""So many presses leave a line free to miss the origin."""


@dataclass(frozen=True, eq=False)
class Scales:
    """Scales of taxels.

    Attributes:
        scale_per_n: (J,) S_j [1/N]; 0 for a taxel that tells nothing.
        sigma_per_n: (J,) their standard errors [1/N].
        offset_counts: (J,) where the lines meet no load [counts]: the zero of the gauge, or a level that has moved.
        common_per_n: the median over the taxels that tell something [1/N].
        residual: (K, J) values less S_j F phi, and less the offset where the level at rest was not seen [counts]; NaN
            where a value was not used.
        told: (J,) taxels that answered.
    """

    scale_per_n: Floats
    sigma_per_n: Floats
    offset_counts: Floats
    common_per_n: float
    residual: Floats
    told: Bools


def fit_scales(
    loads_n: Floats, values: Floats, use: Bools, least_counts: float, *, rest_known: bool = True
) -> Scales:
    """Finds the scale of each taxel.

    Args:
        loads_n: (K, J) loads F phi [N].
        values: (K, J) values above the level at rest [counts].
        use: (K, J) values that are believed.
        least_counts: a taxel that never rises so far tells nothing.
        rest_known: whether the level at rest was seen: few values are laid through it then, else lines are free.
    """
    use = use & np.isfinite(values) & (loads_n > 0)
    y, x = np.where(use, values, 0.0), np.where(use, loads_n, 0.0)
    told = (use.sum(axis=0) >= 2) & ((y > least_counts).sum(axis=0) >= 2)
    # One load alone, as of a press that is drawn again and again, has no line.
    told &= rest_known | (np.ptp(np.where(use, x, x.max(axis=0)), axis=0) > 0)
    free = told & ((use.sum(axis=0) >= _FREE) | (not rest_known))
    weight = use.astype(np.float64)
    scale = offset = np.zeros(y.shape[1])
    squares = np.ones(y.shape[1])
    for _ in range(_ROUNDS):
        total = np.maximum(weight.sum(axis=0), 1e-12)
        mean_x = np.where(free, (weight * x).sum(axis=0) / total, 0.0)
        mean_y = np.where(free, (weight * y).sum(axis=0) / total, 0.0)
        off_x, off_y = x - mean_x, y - mean_y
        squares = np.maximum((weight * off_x**2).sum(axis=0), 1e-30)
        last, scale = scale, (weight * off_x * off_y).sum(axis=0) / squares
        offset = mean_y - scale * mean_x
        off = np.abs(y - scale * x - offset)
        limit = _HUBER * np.maximum(TO_SIGMA * _medians(off, use), 1e-9)
        weight = use * np.minimum(1.0, limit / np.maximum(off, 1e-12))
        if np.allclose(scale, last, rtol=1e-9):
            break
    told &= scale > 0
    scale, offset = np.where(told, scale, 0.0), np.where(told, offset, 0.0)
    residual = np.where(use & told, values - scale * x, np.nan)
    about = np.where(use & told, residual - offset, 0.0)
    spread = np.sqrt((about**2).sum(axis=0) / np.maximum(use.sum(axis=0) - 2, 1))
    common = float(np.median(scale[told])) if told.any() else 0.0
    if not rest_known:  # the offset is then a part of the level
        residual = residual - offset
    return Scales(scale, np.where(told, spread / np.sqrt(squares), 0.0), offset, common, residual, told)


def _medians(off: Floats, use: Bools) -> Floats:
    """Median (J,) of each column of (K, J) over what is used; 0 where nothing is."""
    ranked = np.sort(np.where(use, off, np.inf), axis=0)
    number = use.sum(axis=0)
    middle = np.stack([np.maximum(number - 1, 0) // 2, number // 2]).clip(max=len(off) - 1)
    return np.where(number, np.take_along_axis(ranked, middle, axis=0).mean(axis=0), 0.0)


def common_draws(
    loads_n: Floats,
    values: Floats,
    use: Bools,
    least_counts: float,
    count: int,
    rng: np.random.Generator,
    *,
    rest_known: bool = True,
) -> Floats:
    """Draws of the common scale [1/N], presses resampled (bootstrap); arguments as :func:`fit_scales`.

    Those in which no taxel tells anything, as of one press drawn again and again, are left out: at most ``count`` are
    there.
    """
    rows = rng.integers(0, len(values), (count, len(values)))
    drawn = [
        fit_scales(loads_n[r], values[r], use[r], least_counts, rest_known=rest_known).common_per_n
        for r in rows
    ]
    return np.array([scale for scale in drawn if scale > 0])
