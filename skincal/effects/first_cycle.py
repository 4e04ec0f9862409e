"""The first touch of a site answers otherwise than later ones.

    y = x (1 + a / (1 + t s)^(1 / t)),    s = c / N + k M,    exp(-s) for t = 0

with c the number of earlier touches of the same site and M their largest force. An elastomer softens under its first
loads, and more under larger ones (Mullins effect); a fresh site of a piezoresistive layer needs to be worked in. With
a tail t > 0 the first touches have most of the influence and later ones less and less, instead of equal parts.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import SignalEffect, Stage, known
from skincal.effects.parameter import Values, form, start, strength
from skincal.effects.samples import Samples, Setting
from skincal.model.arrays import FloatArray


class FirstCycle(SignalEffect):
    name = "first_cycle"
    stage = Stage.TRANSFER
    errs_over = "session"
    meaning = "the first touch of a site answers otherwise than later ones"
    parameters = (
        strength("amplitude", "-", 0.0, -0.8, 2.0, "a: change at the first touch", typical=0.2),
        form("cycles", "touches", 0.5, 0.1, 100.0, "N: touches in which it fades", scale="log"),
        form("fading_per_n", "1/N", 0.0, 0.0, 4.0, "k: fading with the largest force met", needs=("met",)),
        form("tail", "-", 0.0, 0.0, 1.0, "t: how slowly the last of it fades"),
    )
    search_from = (
        start({"amplitude": 0.1, "cycles": 0.3}),
        start({"amplitude": 0.1, "cycles": 2.0}),
        start({"amplitude": 0.1, "cycles": 100.0, "fading_per_n": 1.0}),
    )
    covariates = ("cycle",)
    asks = ("again",)
    shows = "touches"
    source = "Mullins, Rubber Chem. Technol. 42 (1969) 339; Diani, Fayolle, Gilormini, Eur. Polym. J. 45 (2009) 601."

    def needs(self, values: Values) -> tuple[str, ...]:
        """Return the covariates (:meth:`Effect.needs`), with the site's largest force if the effect fades with it."""
        found = super().needs(values)
        return (*found, "met") if found and values.number("fading_per_n") else found

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """Apply the effect (:meth:`SignalEffect.apply`). A sample of unknown cycle or earlier force is not changed."""
        assert samples.cycle is not None
        faded, told = np.maximum(samples.cycle, 0.0) / values.number("cycles"), samples.cycle
        if slope := values.number("fading_per_n"):
            assert samples.met_n is not None
            faded, told = faded + slope * np.maximum(samples.met_n, 0.0), samples.cycle + samples.met_n
        if tail := values.number("tail"):
            # Use the logarithm of the denominator: with almost no tail it is the exponential; no division by zero.
            faded = np.log1p(tail * faded) / tail
        return signal * (1.0 + values["amplitude"] * known(told, np.exp(-faded)))[:, None]
