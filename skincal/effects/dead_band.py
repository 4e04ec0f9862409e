"""Small values are swallowed.

    y = x - b ((1 - k) m(x / b) + k (x / b) exp(-(x / b)²))    for x > 0
    m(z) = min(z, 1),    or    r log((1 + exp(1 / r)) / (1 + exp((1 - z) / r)))

b is the width of the band. With k = 0 the first b counts are missing from every value, as from a threshold or a
preload. With k = 1 only values below about b are swallowed and larger ones come out whole. Where the parts of a taxel
respond from different values on, the threshold is soft, with width r relative to b; with r = 0 it is sharp.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import SignalEffect, Stage
from skincal.effects.parameter import MOST_COUNTS, Scene, Start, Values, form, start, strength
from skincal.effects.samples import Samples, Setting
from skincal.model.arrays import FloatArray, as_floats

_SHARP = 1e-3
"""Width below which a threshold is treated as sharp, relative to its band."""


class DeadBand(SignalEffect):
    name = "dead_band"
    stage = Stage.CONVERTER
    meaning = "small values are swallowed"
    parameters = (
        strength("width_counts", "counts", 0.0, 0.0, MOST_COUNTS, "b", typical=8.0),
        form("recovery", "-", 0.0, 0.0, 1.0, "k: how far large values come out whole"),
        form("softness", "-", 0.0, 0.0, 1.0, "r: width of the threshold, in parts of b"),
    )
    source = "Dead zone: Tao, Kokotović, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, 1996."

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        wide = (0.04 * scene.top_counts, 0.12 * scene.top_counts)
        return tuple(start({"width_counts": w, "recovery": k}) for w in wide for k in (0.0, 1.0))

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """Apply the effect (:meth:`SignalEffect.apply`). Values below zero stay as they are."""
        width, recovery = values.number("width_counts"), values.number("recovery")
        inside = np.maximum(signal, 0.0) / width
        missing = (1 - recovery) * _missing(inside, values.number("softness"))
        missing += recovery * inside * np.exp(-(inside**2))
        return signal - width * missing


def _missing(inside: FloatArray, softness: float) -> FloatArray:
    """Return the part of the band that a value lacks: m of the module."""
    if softness < _SHARP:
        return np.minimum(inside, 1.0)
    soft = np.logaddexp(0.0, 1.0 / softness) - np.logaddexp(0.0, (1.0 - inside) / softness)
    return as_floats(softness * soft)
