"""Taxels differ in their level at rest: y_j = x_j + o_j."""

from __future__ import annotations

from skincal.effects.effect import SignalEffect, Stage
from skincal.effects.parameter import EffectParameter, Values
from skincal.effects.samples import Samples
from skincal.effects.setting import Setting
from skincal.effects.starts import Scene, Start, each_of, start
from skincal.model.arrays import FloatArray


class TaxelOffset(SignalEffect):
    """The effect ``taxel_offset``, with the equation of the module."""

    name = "taxel_offset"
    stage = Stage.CONVERTER
    meaning = "taxels differ in their level at rest"
    equation_error = 0.0
    zero_error = 0.0
    parameters = (
        EffectParameter(
            "offset_counts", "counts", 0.0, -65535.0, 65535.0, "o_j", typical=3.0, shape="per-taxel"
        ),
    )
    shows = "taxels"
    replaces_range = "skin.taxel_offset_counts"
    source = "Kasolowsky, Bäuml, IROS 2024, table of randomized parameters: an offset for each taxel."

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        """See :meth:`Effect.starts`."""
        return (start(*each_of("offset_counts", 0.02 * scene.top_counts, scene.taxels)),)

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """See :meth:`SignalEffect.apply`."""
        del samples, setting
        return signal + values["offset_counts"]
