"""Taxels differ in gain: y_j = g_j x_j. A gain that all taxels share is the scale S."""

from __future__ import annotations

from skincal.effects.effect import SignalEffect, Stage
from skincal.effects.parameter import Scene, Start, Values, each_of, per_taxel, start
from skincal.effects.samples import Samples, Setting
from skincal.model.arrays import FloatArray


class TaxelGain(SignalEffect):
    name = "taxel_gain"
    stage = Stage.TRANSFER
    meaning = "taxels differ in gain"
    equation_error = 0.0
    zero_error = 0.0
    parameters = (per_taxel("gain", "-", 1.0, 0.05, 20.0, "g_j", typical=0.12, scale="log"),)
    shows = "taxels"
    replaces_range = "skin.scale_offset_per_n"
    source = "Kasolowsky, Bäuml, IROS 2024, equation 4: the scale S_j may be another for each taxel."

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        return (start(*each_of("gain", 0.05, scene.taxels, 1.0)),)

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        return signal * values["gain"]
