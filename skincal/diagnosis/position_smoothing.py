"""Smooth the measured contact positions of the frames of each press.

Positions from joint angles scatter by a tenth of a millimetre or more from frame to frame, which the skin does not
feel. A hand that gives way moves the contact a little as the force rises. So the position of a press is fitted as a
linear function of its force. Two more columns are added where an F test shows that they are needed: a separate path for
unloading, because friction in the joints leads the contact back another way, and a curve. A press whose residuals from
that path change smoothly in time, such as one that slides, keeps its measured positions.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtri

from skincal.effects.samples import UNLOAD
from skincal.model.arrays import BoolArray, FloatArray, IntArray

_FEWEST = 6
"""Least number of frames of a press, and of degrees of freedom of a test."""
_SMOOTH = 0.25
"""Ratio of half the squared differences of neighbours to the squared residuals, 1 for white noise, below which the
residuals are a motion. Set by eye."""
_EXACT_M = 1e-9
"""Improvement below which positions count as equal [m]."""
_SIGNIFICANCE = 1e-3
"""Significance level of the F test for one more column."""


def smooth_positions(
    position_m: FloatArray, force_n: FloatArray, row: IntArray, phase: IntArray
) -> FloatArray:
    """Return the positions (M, 3) [m] of frames, smoothed press by press.

    Args:
        position_m: (M, 3) measured positions [m], NaN without contact.
        force_n: (M,) forces [N].
        row: (M,) row of the press of each frame, -1 at rest.
        phase: (M,) phases, as in :class:`skincal.effects.Samples`.
    """
    smooth = position_m.copy()
    known = (row >= 0) & np.isfinite(position_m).all(axis=1) & np.isfinite(force_n)
    order = np.flatnonzero(known)[np.argsort(row[known], kind="stable")]
    for own in np.split(order, np.flatnonzero(np.diff(row[order])) + 1):
        if len(own) >= _FEWEST:
            smooth[own] = _smooth_press(position_m[own], force_n[own], phase[own] == UNLOAD)
    return smooth


def _smooth_press(position_m: FloatArray, force_n: FloatArray, is_unloading: BoolArray) -> FloatArray:
    """Return the smoothed positions (m, 3) of one press, whose frames are in the order of time."""
    share = force_n / max(float(np.abs(force_n).max()), 1e-12)
    columns = np.stack([np.ones_like(share), share], axis=1)
    path = _project(columns, position_m)
    for extra in ((1 - share) * is_unloading, share * (1 - share)):
        more = np.column_stack([columns, extra])
        other = _project(more, position_m)
        if _is_significant(position_m, path, other, len(position_m) - more.shape[1]):
            columns, path = more, other
    residual = position_m - path
    total = float((residual**2).sum())
    if 0.5 * float((np.diff(residual, axis=0) ** 2).sum()) < _SMOOTH * total:
        return position_m
    return path


def _project(columns: FloatArray, position_m: FloatArray) -> FloatArray:
    """Return the least-squares fit of positions by columns."""
    return columns @ np.linalg.lstsq(columns, position_m, rcond=None)[0]


def _is_significant(position_m: FloatArray, path: FloatArray, longer: FloatArray, dof: int) -> bool:
    """Test whether a path with one more column, and ``dof`` degrees of freedom left, fits better (F test)."""
    if dof < _FEWEST:
        return False
    before, after = (float(((position_m - p) ** 2).sum()) for p in (path, longer))
    if before - after <= _EXACT_M**2 * position_m.size:
        return False
    # Number of independent directions of the noise: two along a surface, about one for a single joint.
    spread = np.linalg.eigvalsh((position_m - longer).T @ (position_m - longer))
    axes = max(float(spread.sum() ** 2 / max(float((spread**2).sum()), np.finfo(float).tiny)), 1.0)
    return (before - after) * dof > after * float(fdtri(axes, axes * dof, 1 - _SIGNIFICANCE))
