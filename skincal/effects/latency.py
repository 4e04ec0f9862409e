"""The taxels lag behind the force in time.

    phi tau dy/dt = x(t - (1 - phi) tau) - y

with linear interpolation between samples. With phi = 0 it is a pure delay, y(t) = x(t - tau), as from the taxels'
read-out or clocks that disagree; with phi = 1 it is a first-order low-pass filter in the hand's electronics; values in
between approximate a filter of higher order. The mean lag is always tau. It shows where the force changes, in
proportion to dF/dt. Before the first sample of a session the load is assumed constant.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from skincal.effects.effect import MemoryEffect, State
from skincal.effects.parameter import Values, form, start, strength
from skincal.effects.recursion import RELAX, Relaxing, relaxed
from skincal.effects.samples import Samples
from skincal.model.arrays import FloatArray

_NO_LAG_S = 1e-9
"""A filter faster than this has no influence [s]."""


class Latency(MemoryEffect):
    name = "latency"
    zero_error = 0.0
    meaning = "the taxels lag behind the force in time"
    parameters = (
        strength("delay_s", "s", 0.0, 0.0, 1.0, "tau: the mean lag", typical=0.06),
        form("filtered", "-", 0.0, 0.0, 1.0, "phi: the part of it that is a filter's"),
    )
    search_from = tuple(start({"delay_s": 0.03, "filtered": part}) for part in (0.0, 1.0))
    covariates = ("time",)
    asks = ("frames", "clock")
    shows = "quick"
    source = "Transport delay, and a process with dead time and one lag: Ljung, System Identification, 1999."

    def shift_of_clocks_s(self, parameters: Mapping[str, ArrayLike]) -> float:
        """Return the clock offset that the delay may be (:meth:`Effect.shift_of_clocks_s`), without the filter."""
        delay, part = (float(np.asarray(parameters.get(k, 0.0))) for k in ("delay_s", "filtered"))
        return delay * (1 - part)

    def prepare(self) -> None:
        RELAX.prepare()

    def run(
        self, loads_n: FloatArray, samples: Samples, values: Values, state: State
    ) -> tuple[FloatArray, State]:
        assert samples.time_s is not None
        if not len(samples):
            return loads_n, state
        waited, filtering = (None, None) if state is None else state
        lag, part = values.number("delay_s"), values.number("filtered")
        late, waited = _delayed(loads_n, samples.time_s, (1 - part) * lag, waited)
        if part * lag < _NO_LAG_S:
            return late, (waited, None)
        if filtering is None:
            filtering = Relaxing(float(samples.time_s[0]), late[0], late[:1])
        smooth, filtering = relaxed(late, samples.time_s, np.array([part * lag]), filtering)
        return smooth, (waited, filtering)


def _delayed(x: FloatArray, now_s: FloatArray, delay_s: float, before: State) -> tuple[FloatArray, State]:
    """Return loads (K, J) delayed by some time, and the loads that a later call needs."""
    if delay_s < _NO_LAG_S:
        return x, before
    time = now_s
    if before is not None:
        time, x = np.concatenate([before[0], time]), np.vstack([before[1], x])
    asked = now_s - delay_s
    # Everything that a later sample may need, and one sample before.
    first = max(int(np.count_nonzero(time <= asked.max())) - 1, 0)
    return _between(time, x, asked), (time[first:], x[first:])


def _between(time: FloatArray, x: FloatArray, asked: FloatArray) -> FloatArray:
    """Return the values (M, J) at times (M,), interpolated in values (K, J) at times (K,); constant before them."""
    left = np.searchsorted(time, asked, side="right") - 1
    left = np.maximum(left, 0)
    right = np.minimum(left + 1, len(time) - 1)
    gap = time[right] - time[left]
    since = np.maximum(asked - time[left], 0.0)
    part = np.divide(since, gap, out=np.zeros_like(asked), where=gap > 0)[:, None]
    return x[left] + part * (x[right] - x[left])
