"""The level at rest moves over the session.

    y_j = x_j + s_j t + b_j (1 - exp(-t / tau)) + k (T - T_0)

with t the time since the session began: each taxel has a steady drift s_j and a settling b_j; all share a temperature
coefficient k, with the temperature T_0 at which it has no influence. Settling that is over before the first press is
an offset; tau is longer.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import SignalEffect, Stage, known
from skincal.effects.gain_drift import REFERENCE_C
from skincal.effects.parameter import MOST_COUNTS, Scene, Start, Values, form, per_taxel, start, strength
from skincal.effects.samples import Samples, Setting
from skincal.model.arrays import FloatArray


class BaselineDrift(SignalEffect):
    name = "baseline_drift"
    stage = Stage.CONVERTER
    zero_error = 0.0
    errs_over = "session"
    meaning = "the level at rest moves over the session (warm-up, temperature)"
    parameters = (
        per_taxel(
            "slope_counts_per_s",
            "counts/s",
            0.0,
            -MOST_COUNTS,
            MOST_COUNTS,
            "s_j: drift",
            typical=0.01,
            needs=("time",),
        ),
        per_taxel(
            "settling_counts",
            "counts",
            0.0,
            -MOST_COUNTS,
            MOST_COUNTS,
            "b_j: change while settling",
            needs=("time",),
        ),
        form("settling_time_s", "s", 100.0, 20.0, 5000.0, "tau: time of settling", scale="log"),
        strength(
            "temperature_counts_per_k",
            "counts/K",
            0.0,
            -MOST_COUNTS,
            MOST_COUNTS,
            "k",
            needs=("temperature",),
        ),
        form(
            "reference_c",
            "°C",
            REFERENCE_C,
            -20.0,
            80.0,
            "T_0: where k has no influence",
            needs=("temperature",),
        ),
    )
    asks = ("clock",)
    shows = "rests"
    source = "First-order terms of drift and temperature: Fraden, Handbook of Modern Sensors, 2016."

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        ones, eye = np.ones(scene.taxels), np.eye(scene.taxels)
        size = 0.02 * scene.top_counts
        rate, tau = size / max(scene.duration_s, 1.0), float(np.clip(scene.duration_s / 6, 20.0, 5000.0))
        settles = [{"settling_counts": size * e, "settling_time_s": tau} for e in (ones, *(0.5 * eye))]
        slopes = [{"slope_counts_per_s": rate * e} for e in (ones, *(0.5 * eye))]
        return (
            start(slopes[0]),
            start(settles[0]),
            start(*slopes),
            start({"temperature_counts_per_k": size / 4}),
        )

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """Apply the effect (:meth:`SignalEffect.apply`). A sample without a temperature counts as being at 25 °C."""
        time = samples.elapsed_s[:, None]
        settled = -np.expm1(-time / values.number("settling_time_s"))
        level = values["slope_counts_per_s"] * time + values["settling_counts"] * settled
        if values["temperature_counts_per_k"] != 0:
            warmer = np.full(len(time), REFERENCE_C - values.number("reference_c"))
            if samples.temperature_c is not None:
                warmer += known(samples.temperature_c, samples.temperature_c - REFERENCE_C)
            level = level + (values["temperature_counts_per_k"] * warmer)[:, None]
        return signal + level
