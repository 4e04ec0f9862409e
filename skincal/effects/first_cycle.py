"""The first touch of a site answers otherwise than later ones.

    y = x (1 + a exp(-c / N))

with c the number of earlier touches of the same site: an elastomer softens under its first loads (Mullins effect), and
a fresh site of a piezoresistive layer needs to be worked in.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.base import SignalEffect, Stage, known
from skincal.effects.parameter import EffectParameter, Values
from skincal.effects.samples import Samples
from skincal.effects.setting import Setting
from skincal.model.arrays import FloatArray


class FirstCycle(SignalEffect):
    """See the module."""

    name = "first_cycle"
    stage = Stage.TRANSFER
    meaning = "the first touch of a site answers otherwise than later ones"
    parameters = (
        EffectParameter("amplitude", "-", 0.0, -0.8, 2.0, "a: change at the first touch", typical=0.2),
        EffectParameter(
            "cycles", "touches", 0.5, 0.1, 20.0, "N: touches in which it fades", role="form", scale="log"
        ),
    )
    covariates = ("cycle",)
    source = "Mullins, Rubber Chem. Technol. 42 (1969) 339; Diani, Fayolle, Gilormini, Eur. Polym. J. 45 (2009) 601."

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """See :meth:`SignalEffect.apply`. A sample whose cycle is not known is left as it is."""
        del setting
        assert samples.cycle is not None
        fading = np.exp(-np.maximum(samples.cycle, 0.0) / values.number("cycles"))
        return signal * (1.0 + values["amplitude"] * known(samples.cycle, fading))[:, None]
