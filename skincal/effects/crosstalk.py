"""A taxel leaks into its nearest neighbours.

y_j = x_j + c (sum of x_i over the up to four next taxels in the row and the column)
"""

from __future__ import annotations

from skincal.effects.base import SignalEffect, Stage
from skincal.effects.parameter import EffectParameter, Values
from skincal.effects.samples import Samples
from skincal.effects.setting import Setting
from skincal.model.arrays import FloatArray


class Crosstalk(SignalEffect):
    """See the module."""

    name = "crosstalk"
    stage = Stage.CROSSTALK
    meaning = "a taxel leaks into its nearest neighbours"
    parameters = (
        EffectParameter("leak", "-", 0.0, -0.2, 0.5, "c: part that each neighbour gets", typical=0.08),
    )
    source = "Nearest-neighbour coupling to first order, as between pixels: Rieke, Detection of Light, 2003."

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """See :meth:`SignalEffect.apply`."""
        del samples
        return signal + values["leak"] * (signal @ setting.neighbours)
