"""Large values are compressed or clipped.

    y = x / (1 + (k x)^p)^(1/p)    for x > 0

1 / k is the value in counts that is never reached. The sharpness p goes from a gradual compression (1.5) to a hard
clip (20 and more). Below 1.5 it would bend small values as well, which is ``response_curve``.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import SignalEffect, Stage
from skincal.effects.parameter import MOST_COUNTS, Scene, Start, Values, form, start, strength
from skincal.effects.samples import Samples, Setting
from skincal.model.arrays import FloatArray


class Saturation(SignalEffect):
    name = "saturation"
    stage = Stage.CONVERTER
    meaning = "large values are compressed or clipped"
    parameters = (
        strength(
            "inverse_ceiling_per_count",
            "1/counts",
            0.0,
            0.0,
            MOST_COUNTS,
            "k: one over the ceiling",
            typical=1 / 80,
        ),
        form("sharpness", "-", 4.0, 1.5, 30.0, "p", scale="log"),
    )
    asks = ("forces",)
    source = (
        "Rapp's model of a limiting amplifier: Rapp, 2nd European Conf. on Satellite Communications, 1991."
    )

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        forms = ((0.5, 1.5), (0.8, 3.0), (1.1, 10.0))
        top = scene.top_counts
        return tuple(start({"inverse_ceiling_per_count": k / top, "sharpness": p}) for k, p in forms)

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """Apply the effect (:meth:`SignalEffect.apply`). Values below zero stay as they are."""
        sharpness = values.number("sharpness")
        relative = values["inverse_ceiling_per_count"] * np.maximum(signal, 0.0)
        # Factor out the larger of one and (k x)^p, so that neither overflows.
        most, least = np.maximum(relative, 1.0), np.minimum(relative, 1.0)
        ratio = np.where(relative > 1.0, 1.0 / most, least)
        return signal / (most * (1.0 + ratio**sharpness) ** (1.0 / sharpness))
