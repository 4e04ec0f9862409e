"""The sensitivity moves over the session (wear, warm-up, temperature).

    y = x exp(r t + b (1 - exp(-t / tau)) + k (T - 25 °C))

with t the time since the session began: steady wear r, a settling b as from warming up, and a temperature
coefficient k.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import SignalEffect, Stage, known
from skincal.effects.parameter import Scene, Start, Values, form, start, strength
from skincal.effects.samples import Samples, Setting
from skincal.model.arrays import FloatArray

REFERENCE_C = 25.0
"""The temperature at which the gain is one [°C]."""


class GainDrift(SignalEffect):
    name = "gain_drift"
    stage = Stage.TRANSFER
    errs_over = "session"
    meaning = "the sensitivity moves over the session (wear, warm-up, temperature)"
    parameters = (
        strength(
            "rate_per_s", "1/s", 0.0, -2e-2, 2e-2, "r: change each second", typical=-5e-4, needs=("time",)
        ),
        strength(
            "settling", "-", 0.0, -1.0, 1.0, "b: relative change while settling (warm-up)", needs=("time",)
        ),
        form("settling_time_s", "s", 100.0, 5.0, 5000.0, "tau: time of settling", scale="log"),
        strength("temperature_per_k", "1/K", 0.0, -0.2, 0.2, "k: change each kelvin", needs=("temperature",)),
    )
    asks = ("clock",)
    shows = "session"
    source = "First-order terms of drift and temperature: Fraden, Handbook of Modern Sensors, 2016."

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        span = max(scene.duration_s, 1.0)
        tau = float(np.clip(span / 6, 5.0, 5000.0))
        return (
            start({"rate_per_s": 0.1 / span}),
            start({"settling": 0.1, "settling_time_s": tau}),
            start({"temperature_per_k": 0.01}),
        )

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """Apply the effect (:meth:`SignalEffect.apply`). A sample without a temperature is at the reference."""
        time = samples.elapsed_s
        exponent = values["rate_per_s"] * time
        exponent = exponent - values["settling"] * np.expm1(-time / values.number("settling_time_s"))
        if values["temperature_per_k"] != 0 and samples.temperature_c is not None:
            warmer = samples.temperature_c - REFERENCE_C
            exponent = exponent + values["temperature_per_k"] * known(samples.temperature_c, warmer)
        return signal * np.exp(exponent)[:, None]
