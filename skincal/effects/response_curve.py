"""The counts are a nonlinear function of the taxel's load.

    y = x_0 ((1 + x / x_0)^g - 1) / g

for x > 0: linear with slope one for small loads, a power g beyond the knee x_0. g = 2 is a parabola, g = 1 a straight
line, g = 0 a logarithm, g = -1 a voltage divider, y = x / (1 + x / x_0). All taxels have the same curve.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import SignalEffect, Stage
from skincal.effects.parameter import Scene, Start, Values, form, start, strength
from skincal.effects.samples import Samples, Setting
from skincal.model.arrays import FloatArray


class ResponseCurve(SignalEffect):
    name = "response_curve"
    stage = Stage.TRANSFER
    meaning = "the counts are a nonlinear function of the taxel's load"
    parameters = (
        strength("exponent", "-", 1.0, -1.0, 3.0, "g", typical=-0.35),
        form("knee_n", "N", 0.2, 0.01, 5.0, "x_0", scale="log"),
    )
    asks = ("forces",)
    source = (
        "Box, Cox, J. R. Stat. Soc. B 26 (1964) 211 (shifted power); conductance of piezoresistive taxels: "
        "Paredes-Madrid et al., DYNA 85 (2018), doi 10.15446/dyna.v85n205.66432."
    )

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        return tuple(
            start({"exponent": 0.7, "knee_n": float(np.clip(x * scene.top_n, 0.01, 5.0))}) for x in (0.1, 1.0)
        )

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """Apply the effect (:meth:`SignalEffect.apply`). Loads below zero stay as they are."""
        exponent, knee = values.number("exponent"), values.number("knee_n")
        log = np.log1p(np.maximum(signal, 0.0) / knee)
        bent = np.expm1(exponent * log) / exponent if exponent else log
        return np.where(signal > 0, knee * bent, signal)
