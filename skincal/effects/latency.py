"""The taxels lag behind the force in time.

    y(t) = x(t - tau)

with straight lines between samples: a pure delay, as from the taxels' read-out, a filter in the hand's electronics or
clocks that do not agree. It shows where the force changes, in proportion to dF/dt. Before the first sample of a session
the load is taken to have been as in the first.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.base import MemoryEffect, State
from skincal.effects.parameter import EffectParameter, Values
from skincal.effects.samples import Samples
from skincal.model.arrays import FloatArray


class Latency(MemoryEffect):
    """See the module."""

    name = "latency"
    meaning = "the taxels lag behind the force in time"
    parameters = (EffectParameter("delay_s", "s", 0.0, 0.0, 1.0, "tau", typical=0.06),)
    covariates = ("time",)
    source = "Transport delay; Ljung, System Identification, 1999."

    def run(
        self, loads_n: FloatArray, samples: Samples, values: Values, state: State
    ) -> tuple[FloatArray, State]:
        """See :meth:`MemoryEffect.run`."""
        assert samples.time_s is not None
        if not len(samples):
            return loads_n, state
        time, x = samples.time_s, loads_n
        if state is not None:
            time, x = np.concatenate([state[0], time]), np.vstack([state[1], x])
        asked = samples.time_s - values.number("delay_s")
        # All that a later sample may ask for, and one sample before.
        first = max(int(np.count_nonzero(time <= asked.max())) - 1, 0)
        return _between(time, x, asked), (time[first:], x[first:])


def _between(time: FloatArray, x: FloatArray, asked: FloatArray) -> FloatArray:
    """Values (M, J) at times asked (M,), from values (K, J) at times (K,); before the first it was as then."""
    left = np.searchsorted(time, asked, side="right") - 1
    left = np.maximum(left, 0)
    right = np.minimum(left + 1, len(time) - 1)
    gap = time[right] - time[left]
    since = np.maximum(asked - time[left], 0.0)
    part = np.divide(since, gap, out=np.zeros_like(asked), where=gap > 0)[:, None]
    return x[left] + part * (x[right] - x[left])
