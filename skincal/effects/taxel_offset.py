"""Taxels differ in their level at rest: y_j = x_j + o_j."""

from __future__ import annotations

from skincal.effects.effect import SignalEffect, Stage
from skincal.effects.parameter import MOST_COUNTS, Scene, Start, Values, each_of, per_taxel, start
from skincal.effects.samples import Samples, Setting
from skincal.model.arrays import FloatArray


class TaxelOffset(SignalEffect):
    name = "taxel_offset"
    stage = Stage.CONVERTER
    meaning = "taxels differ in their level at rest"
    equation_error = 0.0
    zero_error = 0.0
    parameters = (per_taxel("offset_counts", "counts", 0.0, -MOST_COUNTS, MOST_COUNTS, "o_j", typical=3.0),)
    shows = "taxels"
    replaces_range = "skin.taxel_offset_counts"
    source = "Kasolowsky, Bäuml, IROS 2024, table of randomized parameters: an offset for each taxel."

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        return (start(*each_of("offset_counts", 0.02 * scene.top_counts, scene.taxels)),)

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        return signal + values["offset_counts"]
