"""Relaxations over time, for all taxels at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skincal.effects.loops import Loop
from skincal.model.arrays import FloatArray

_SMALL = 1e-4
"""Steps shorter than this part of the time constant use a series expansion."""


class Relaxing(NamedTuple):
    """State of T relaxations: its time [s], the input (J,) then, and the relaxed values (T, J)."""

    time_s: float
    input_now: FloatArray
    lagging: FloatArray


def relaxed(
    x: FloatArray, time_s: FloatArray, time_constants_s: FloatArray, before: Relaxing | None
) -> tuple[FloatArray, Relaxing | None]:
    """Return the mean of q_t (K, J) and the last state; tau_t dq_t/dt = x - q_t for an input linear between samples.

    Args:
        x: (K, J) input.
        time_s: (K,) its times, never falling [s].
        time_constants_s: (T,) tau_t [s].
        before: state after the previous call; None: q = 0 at the first sample.
    """
    if not len(x):
        return x.copy(), before
    if before is None:
        before = Relaxing(float(time_s[0]), x[0], np.zeros((len(time_constants_s), x.shape[1])))
    h = np.diff(time_s, prepend=before.time_s)[:, None] / time_constants_s
    keep = np.exp(-h)
    # Mean of exp(-s) over the step, and the weight of the older end of the line.
    mean = np.where(h < _SMALL, 1 - h / 2 + h**2 / 6, -np.expm1(-h) / np.where(h > 0, h, 1.0))
    x, q, out = np.array(x), before.lagging.copy(), np.zeros(x.shape)
    RELAX(x, np.array(before.input_now), np.stack([keep, 1 - mean, mean - keep]), q, out)
    return out, Relaxing(float(time_s[-1]), x[-1], q)


def _relax(
    x: FloatArray, first: FloatArray, parts: FloatArray, q: FloatArray, out: FloatArray
) -> None:  # pragma: no cover - compiled
    count, constants, taxels = len(x), len(q), len(first)
    for k in range(count):
        older = first if k == 0 else x[k - 1]
        for t in range(constants):
            keep, now, then = parts[0, k, t], parts[1, k, t], parts[2, k, t]
            for j in range(taxels):
                q[t, j] = keep * q[t, j] + (x[k, j] * now + older[j] * then)
                out[k, j] += q[t, j]
        for j in range(taxels):
            out[k, j] /= constants


RELAX = Loop(_relax, "void(f8[:, ::1], f8[::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1])")
"""For effects that relax, to be prepared."""
