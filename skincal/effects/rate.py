"""The response depends on the speed of loading.

    y = x (1 + v / v_0)^(n phi)

with v the speed of loading of the press, and v_0 the speed from which it matters: far below it the response is the
base model's, far above it a power of the speed. phi is one while the load rises, and decays as exp(-age / T) from the
end of loading: a viscous stiffening may fade in the hold (small T) or last for the whole press (large T).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skincal.effects.effect import MemoryEffect, State
from skincal.effects.parameter import Scene, Start, Values, form, start, strength
from skincal.effects.samples import LOAD, UNKNOWN, Samples
from skincal.model.arrays import FloatArray


class _Last(NamedTuple):
    """The last moment of loading [s], and its press."""

    time_s: float
    press: int


class Rate(MemoryEffect):
    name = "rate"
    meaning = "the response depends on the speed of loading"
    parameters = (
        strength("exponent", "-", 0.0, -0.5, 0.5, "n", typical=0.12),
        form("fade_s", "s", 100.0, 0.02, 1000.0, "T: time in which it fades after loading", scale="log"),
        form("slow_m_per_s", "m/s", 1e-3, 1e-5, 0.1, "v_0: speed from which it matters", scale="log"),
    )
    covariates = ("speed", "phase", "time")
    asks = ("speeds", "clock")
    shows = "speeds"
    source = (
        "Power law of the strain rate with fading memory: Pipkin, Rogers, J. Mech. Phys. Solids 16 (1968) 59; "
        "Lakes, Viscoelastic Materials, 2009, chapter 2. A power law that ends at low rates: Cross, J. Colloid Sci. 20 "
        "(1965) 417."
    )

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        slow = (1e-5, scene.speed_m_per_s)
        return tuple(
            start({"exponent": 0.05, "fade_s": t, "slow_m_per_s": v}) for t in (1000.0, 0.3) for v in slow
        )

    def run(
        self, loads_n: FloatArray, samples: Samples, values: Values, state: State
    ) -> tuple[FloatArray, State]:
        """Return the loads (:meth:`MemoryEffect.run`). A sample of unknown speed is not changed."""
        assert samples.speed_m_per_s is not None
        age, state = _age_s(samples, state)
        relative = 1 + np.maximum(samples.speed_m_per_s, 0.0) / values.number("slow_m_per_s")
        power = values.number("exponent") * np.exp(-age / values.number("fade_s"))
        power = np.where(np.isfinite(relative), power, 0.0)
        factor = np.power(np.where(np.isfinite(relative), relative, 1.0), power)
        return loads_n * factor[:, None], state


def _age_s(samples: Samples, last: _Last | None) -> tuple[FloatArray, _Last | None]:
    """Return the time since loading ended (K,) [s]; zero during loading, in unknown phases, and as a press begins."""
    assert samples.phase is not None and samples.time_s is not None
    if not len(samples):
        return np.zeros(0), last
    time, press = samples.time_s, samples.press
    before = np.concatenate([[-2 if last is None else last.press], press[:-1]])
    fresh = (samples.phase == LOAD) | (samples.phase == UNKNOWN) | ~samples.touching | (press != before)
    since = np.where(fresh, time, -np.inf)
    if last is not None:
        since[0] = max(since[0], last.time_s)
    since = np.maximum.accumulate(since)
    return time - since, _Last(float(since[-1]), int(press[-1]))
