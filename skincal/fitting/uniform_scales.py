"""The scale of each taxel under uniform pressure, where neither pose nor elasticity matter.

The model reduces to D_kj = S_j F_k phi_j: a straight line for each taxel. Its slope is found by robust least
squares (Huber's weights, Ann. Math. Stat. 35 (1964) 73). With enough presses the line need not pass through the
origin, so that neither a zero offset of a pressure gauge nor a jump of the rest level biases the scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.fitting.types import Bools, Floats
from skincal.statistics import TO_SIGMA

_HUBER = 1.345
"""Huber's constant, for 95 % efficiency with normal noise."""
_ROUNDS = 30
"""Most rounds of reweighting."""
_FREE = 5
"""From this many presses on, a line may miss the origin."""


@dataclass(frozen=True, eq=False)
class Scales:
    """Scales of taxels.

    Attributes:
        scale_per_n: (J,) S_j [1/N]; 0 for a taxel that does not respond.
        sigma_per_n: (J,) their standard errors [1/N].
        offset_counts: (J,) values of the lines at no load [counts]: zero offset of the gauge, or a level that
            has moved.
        common_per_n: the median over the taxels that respond [1/N].
        residual: (K, J) values less S_j F phi, and less the offset if the rest level was not seen [counts];
            NaN where a value was not used.
        responding: (J,) taxels that respond.
    """

    scale_per_n: Floats
    sigma_per_n: Floats
    offset_counts: Floats
    common_per_n: float
    residual: Floats
    responding: Bools


def fit_scales(
    loads_n: Floats, values: Floats, use: Bools, least_counts: float, *, rest_known: bool = True
) -> Scales:
    """Fit the scale of each taxel.

    Args:
        loads_n: (K, J) loads F phi [N].
        values: (K, J) values above the rest level [counts].
        use: (K, J) values to use.
        least_counts: value that a taxel must exceed in two presses to count as responding.
        rest_known: whether the rest level was seen. If so, lines of few values pass through it; else all
            lines are free.
    """
    use = use & np.isfinite(values) & (loads_n > 0)
    y, x = np.where(use, values, 0.0), np.where(use, loads_n, 0.0)
    responding = (use.sum(axis=0) >= 2) & ((y > least_counts).sum(axis=0) >= 2)
    # A single load, as of one press resampled again and again, defines no line.
    responding &= rest_known | (np.ptp(np.where(use, x, x.max(axis=0)), axis=0) > 0)
    free = responding & ((use.sum(axis=0) >= _FREE) | (not rest_known))
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
    responding &= scale > 0
    scale, offset = np.where(responding, scale, 0.0), np.where(responding, offset, 0.0)
    residual = np.where(use & responding, values - scale * x, np.nan)
    about = np.where(use & responding, residual - offset, 0.0)
    spread = np.sqrt((about**2).sum(axis=0) / np.maximum(use.sum(axis=0) - 2, 1))
    common = float(np.median(scale[responding])) if responding.any() else 0.0
    if not rest_known:  # the offset is then a part of the level
        residual = residual - offset
    return Scales(
        scale, np.where(responding, spread / np.sqrt(squares), 0.0), offset, common, residual, responding
    )


def _medians(off: Floats, use: Bools) -> Floats:
    """Return the median (J,) of each column of (K, J) over the values that are used; 0 if there are none."""
    ranked = np.sort(np.where(use, off, np.inf), axis=0)
    number = use.sum(axis=0)
    middle = np.stack([np.maximum(number - 1, 0) // 2, number // 2]).clip(max=len(off) - 1)
    return np.where(number, np.take_along_axis(ranked, middle, axis=0).mean(axis=0), 0.0)


def bootstrap_common_scale(
    loads_n: Floats,
    values: Floats,
    use: Bools,
    least_counts: float,
    count: int,
    rng: np.random.Generator,
    *,
    rest_known: bool = True,
) -> Floats:
    """Return draws of the common scale [1/N] by a bootstrap over presses; arguments as for :func:`fit_scales`.

    Draws in which no taxel responds, as of one press resampled again and again, are left out.
    """
    rows = rng.integers(0, len(values), (count, len(values)))
    drawn = [
        fit_scales(loads_n[r], values[r], use[r], least_counts, rest_known=rest_known).common_per_n
        for r in rows
    ]
    return np.array([scale for scale in drawn if scale > 0])
