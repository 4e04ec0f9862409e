"""A taxel leaks into its nearest neighbours.

    y = x + c (1 + h A) A x,    A x = N x - l D x

N sums over the taxels next to it, by their positions: up to four in a grid, six in a hexagonal layout; D is their
number. The source taxel may lose what leaks (l): with l = 1 the load is shared, as in a resistive sheet; with l = 0 it
is picked up in addition, as between wires. It may leak on (h); a sheet has h = c, to second order in c.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import SignalEffect, Stage
from skincal.effects.parameter import Values, form, start, strength
from skincal.effects.samples import Samples, Setting
from skincal.model.arrays import FloatArray


class Crosstalk(SignalEffect):
    name = "crosstalk"
    stage = Stage.CROSSTALK
    errs_over = "place"
    meaning = "a taxel leaks into its nearest neighbours"
    parameters = (
        strength("leak", "-", 0.0, -0.2, 0.5, "c: part that each neighbour gets", typical=0.08),
        form("reach", "-", 0.0, 0.0, 0.3, "h: part of it that leaks on"),
        form("loss", "-", 0.0, 0.0, 1.0, "l: part of it that the taxel loses"),
    )
    search_from = tuple(start({"leak": 0.04, "loss": loss}) for loss in (0.0, 1.0))
    shows = "places"
    source = "Nearest-neighbour coupling to first order, as between pixels: Rieke, Detection of Light, 2003."

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        near = setting.neighbours
        flow = near - np.diag(values.number("loss") * near.sum(axis=0))
        first = signal @ flow
        return signal + values["leak"] * (first + values["reach"] * (first @ flow))
