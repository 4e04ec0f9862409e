"""The signal goes on rising (or falls) at constant force.

    y = max(x + a (mean of q_k), 0),    tau_k dq_k/dt = x - q_k,    tau_k = tau 10^{-b/2}, tau, tau 10^{+b/2}

A Prony series of three Kelvin-Voigt elements: at constant load the signal tends to (1 + a) x; with a < 0 the signal
falls, and as no load is negative, nothing is left of it once the press has gone. With the breadth b = 0 it is a
single exponential. With b of two or three decades it follows the logarithm of time over that range, as elastomers and
piezoresistive foams do. The load is interpolated linearly between samples, for which the recursion is exact. A
session begins with a skin at rest, all q_k = 0.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import MemoryEffect, State
from skincal.effects.parameter import Values, form, start, strength
from skincal.effects.recursion import RELAX, relaxed
from skincal.effects.samples import Samples
from skincal.model.arrays import FloatArray


class Creep(MemoryEffect):
    name = "creep"
    meaning = "the signal goes on rising (or falls) at constant force"
    parameters = (
        strength("amplitude", "-", 0.0, -0.6, 1.5, "a: the rise in the limit, over the load", typical=0.2),
        form("time_constant_s", "s", 1.5, 0.02, 200.0, "tau, the middle one", scale="log"),
        form("breadth", "decades", 0.0, 0.0, 3.0, "b: range of the time constants"),
    )
    search_from = tuple(
        start({"amplitude": 0.1, "time_constant_s": tau, "breadth": b})
        for tau, b in ((0.3, 0.7), (1.5, 0.7), (8.0, 0.7), (1.5, 2.0))
    )
    covariates = ("time",)
    asks = ("frames", "clock")
    source = (
        "Prony series and its recursion: Simo, Hughes, Computational Inelasticity, 1998, 10.3; creep of force "
        "sensing resistors: Paredes-Madrid et al., Materials 10 (2017) 1334."
    )

    def prepare(self) -> None:
        RELAX.prepare()

    def run(
        self, loads_n: FloatArray, samples: Samples, values: Values, state: State
    ) -> tuple[FloatArray, State]:
        assert samples.time_s is not None
        breadth = values.number("breadth")
        decades = np.array([0.0]) if breadth == 0 else breadth * np.array([-0.5, 0.0, 0.5])
        times = values.number("time_constant_s") * 10**decades
        lagging, state = relaxed(loads_n, samples.time_s, times, state)
        return np.maximum(loads_n + values["amplitude"] * lagging, 0.0), state
