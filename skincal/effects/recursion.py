"""Linear recursions over time, for all taxels at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skincal.model.arrays import FloatArray

_SMALL = 1e-4
"""Steps shorter than this part of the time constant use a series expansion."""
_FORGOTTEN = 1e-18
"""Remaining factor below which a value is forgotten."""


class Relaxing(NamedTuple):
    """State of a relaxation: its time [s], the input (1, J) then, and the relaxed value (1, J)."""

    time_s: float
    input_now: FloatArray
    lagging: FloatArray


def relaxed(
    x: FloatArray, time_s: FloatArray, time_constant_s: float, before: Relaxing | None
) -> tuple[FloatArray, Relaxing | None]:
    """Return q (K, J), which solves tau dq/dt = x - q for an input linear between samples, and the last state.

    Args:
        x: (K, J) input.
        time_s: (K,) its times, never falling [s].
        time_constant_s: tau [s].
        before: state after the previous call; None: q = 0 at the first sample.
    """
    if not len(x):
        return x.copy(), before
    if before is None:
        before = Relaxing(float(time_s[0]), x[:1], np.zeros((1, x.shape[1])))
    h = np.diff(time_s, prepend=before.time_s)[:, None] / time_constant_s
    keep = np.exp(-h)
    # Mean of exp(-s) over the step, and the weight of the older end of the line.
    mean = np.where(h < _SMALL, 1 - h / 2 + h**2 / 6, -np.expm1(-h) / np.where(h > 0, h, 1.0))
    older = np.vstack([before.input_now, x[:-1]])
    q = recursion(keep, x * (1 - mean) + older * (mean - keep), before.lagging)
    return q, Relaxing(float(time_s[-1]), x[-1:], q[-1:])


def recursion(keep: FloatArray, add: FloatArray, start: FloatArray) -> FloatArray:
    """Return y_k = keep_k y_{k-1} + add_k, in a logarithmic number of passes over whole arrays.

    Args:
        keep: (K, 1).
        add: (K, J).
        start: (1, J) y before the first sample.
    """
    y, factor = add.copy(), keep.copy()
    y[:1] += keep[:1] * start
    reach = 1
    # Terms that have decayed below the last digit add nothing.
    while reach < len(y) and factor[reach:].max() > _FORGOTTEN:
        # Evaluate the right side completely before assigning: it must not see values that have already changed.
        y[reach:] += factor[reach:] * y[:-reach].copy()
        factor[reach:] *= factor[:-reach].copy()
        reach *= 2
    return y
