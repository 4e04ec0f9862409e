"""The signal goes on rising (or falls) at constant force.

    y = x + a (mean of q_k),    tau_k dq_k/dt = x - q_k,    tau_k = tau 10^{-b/2}, tau, tau 10^{+b/2}

A Prony series of three Kelvin-Voigt elements: at constant load the signal tends to (1 + a) x; with a < 0 the signal
falls. With the breadth b = 0 it is a single exponential. With b of two or three decades it follows the logarithm of
time over that range, as elastomers and piezoresistive foams do. The load is interpolated linearly between samples, for
which the recursion is exact. A session begins with a skin at rest, all q_k = 0.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import MemoryEffect, State
from skincal.effects.parameter import EffectParameter, Values
from skincal.effects.recursion import relaxed
from skincal.effects.samples import Samples
from skincal.effects.starts import Scene, Start, start
from skincal.model.arrays import FloatArray


class Creep(MemoryEffect):
    """The effect ``creep``, with the equation of the module."""

    name = "creep"
    meaning = "the signal goes on rising (or falls) at constant force"
    parameters = (
        EffectParameter(
            "amplitude", "-", 0.0, -0.6, 1.5, "a: the rise in the limit, over the load", typical=0.2
        ),
        EffectParameter(
            "time_constant_s", "s", 1.5, 0.02, 200.0, "tau, the middle one", role="form", scale="log"
        ),
        EffectParameter("breadth", "decades", 0.0, 0.0, 3.0, "b: range of the time constants", role="form"),
    )
    covariates = ("time",)
    asks = ("frames", "clock")
    source = (
        "Prony series and its recursion: Simo, Hughes, Computational Inelasticity, 1998, 10.3; creep of force "
        "sensing resistors: Paredes-Madrid et al., Materials 10 (2017) 1334."
    )

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        """See :meth:`Effect.starts`."""
        del scene
        forms = ((0.3, 0.0), (1.5, 0.0), (8.0, 0.0), (1.5, 2.0))
        return tuple(start({"amplitude": 0.1, "time_constant_s": t, "breadth": b}) for t, b in forms)

    def run(
        self, loads_n: FloatArray, samples: Samples, values: Values, state: State
    ) -> tuple[FloatArray, State]:
        """See :meth:`MemoryEffect.run`."""
        assert samples.time_s is not None
        breadth = values.number("breadth")
        decades = np.array([0.0]) if breadth == 0 else breadth * np.array([-0.5, 0.0, 0.5])
        times = values.number("time_constant_s") * 10**decades
        if state is None:
            state = [None] * len(times)
        lagging, after = np.zeros_like(loads_n), list[State]()
        for time_constant, before in zip(times, state, strict=True):
            q, end = relaxed(loads_n, samples.time_s, float(time_constant), before)
            lagging += q
            after.append(end)
        return loads_n + values["amplitude"] * lagging / len(times), after
