"""Compiled loops over time, in which a sample needs what the one before has left behind; relaxations."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from skincal.model.arrays import FloatArray

_SMALL = 1e-4
"""Steps shorter than this part of the time constant use a series expansion."""


class Loop:
    """Plain scalar code on arrays that are passed in, compiled or loaded when it is needed; so is numba imported."""

    def __init__(self, function: Callable[..., None], signature: str) -> None:
        """Take the code, and numba's signature of what it takes."""
        self._function, self._signature = function, signature

    def __call__(self, *arrays: Any) -> None:
        """Run it."""
        self._compiled(*arrays)

    def prepare(self) -> None:
        """Compile it."""
        _ = self._compiled

    @cached_property
    def _compiled(self) -> Any:
        from skincal.model.press.jit import cached, reporting_compilation

        settings = {"nogil": True, "error_model": "numpy"}
        with reporting_compilation():
            return cached(self._function, self._function.__name__, settings, self._signature)


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
