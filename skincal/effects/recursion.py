"""Linear recursions over time, all taxels at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import FloatArray

_SMALL = 1e-4
"""Steps shorter than this part of the time constant use a series."""
_FORGOTTEN = 1e-18
"""What is left of a value that no longer counts."""


@dataclass(frozen=True, eq=False)
class Relaxing:
    """Where a relaxation stands.

    Attributes:
        time_s: at that moment [s].
        input_now: (1, J) the input then.
        lagging: (1, J) what lags behind it.
    """

    time_s: float
    input_now: FloatArray
    lagging: FloatArray


def relaxed(
    x: FloatArray, time_s: FloatArray, time_constant_s: float, before: Relaxing | None
) -> tuple[FloatArray, Relaxing | None]:
    """Return the Tau dq/dt = x - q, exactly, for an input that goes in straight lines from sample to sample.

    Args:
        x: (K, J) input.
        time_s: (K,) its times, never falling [s].
        time_constant_s: tau [s].
        before: where an earlier call ended; None: q = 0 at the first sample.

    Returns:
        q (K, J), and where it ends.
    """
    if not len(x):
        return x.copy(), before
    if before is None:
        before = Relaxing(float(time_s[0]), x[:1], np.zeros((1, x.shape[1])))
    h = np.diff(time_s, prepend=before.time_s)[:, None] / time_constant_s
    keep = np.exp(-h)
    # Mean of exp(-s) over the step, and what it leaves to the older end of the line.
    mean = np.where(h < _SMALL, 1 - h / 2 + h**2 / 6, -np.expm1(-h) / np.where(h > 0, h, 1.0))
    older = np.vstack([before.input_now, x[:-1]])
    q = recursion(keep, x * (1 - mean) + older * (mean - keep), before.lagging)
    return q, Relaxing(float(time_s[-1]), x[-1:], q[-1:])


def recursion(keep: FloatArray, add: FloatArray, start: FloatArray) -> FloatArray:
    """Return the y_k = keep_k y_{k-1} + add_k, in a logarithmic number of passes over whole arrays.

    Args:
        keep: (K, 1).
        add: (K, J).
        start: (1, J) y before the first.
    """
    y, factor = add.copy(), keep.copy()
    y[:1] += keep[:1] * start
    reach = 1
    # What is forgotten by then to the last digit adds nothing.
    while reach < len(y) and factor[reach:].max() > _FORGOTTEN:
        # Both sides at once: the right side must not see what the left side has already changed.
        y[reach:] += factor[reach:] * y[:-reach].copy()
        factor[reach:] *= factor[:-reach].copy()
        reach *= 2
    return y
