"""Taxels differ in gain: y_j = g_j x_j. A gain that all taxels share is the scale S."""

from __future__ import annotations

from skincal.effects.effect import SignalEffect, Stage
from skincal.effects.parameter import EffectParameter, Values
from skincal.effects.samples import Samples
from skincal.effects.setting import Setting
from skincal.effects.starts import Scene, Start, each_of, start
from skincal.model.arrays import FloatArray


class TaxelGain(SignalEffect):
    """The effect ``taxel_gain``, with the equation of the module."""

    name = "taxel_gain"
    stage = Stage.TRANSFER
    meaning = "taxels differ in gain"
    equation_error = 0.0
    zero_error = 0.0
    parameters = (
        EffectParameter("gain", "-", 1.0, 0.05, 20.0, "g_j", typical=0.12, shape="per-taxel", scale="log"),
    )
    shows = "taxels"
    replaces_range = "skin.scale_offset_per_n"
    source = "Kasolowsky, Bäuml, IROS 2024, equation 4: the scale S_j may be another for each taxel."

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        """See :meth:`Effect.starts`."""
        return (start(*each_of("gain", 0.05, scene.taxels, 1.0)),)

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """See :meth:`SignalEffect.apply`."""
        del samples, setting
        return signal * values["gain"]
