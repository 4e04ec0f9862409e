"""The indenter does not have the size that the dataset states.

    R = R_said + (s - 1) R_said^(1 - w) R_0^w,    R_0 = 5 mm

for an indenter that still touches at the same place. With w = 0 every indenter is off by the same
factor, with w = 1 by the same length, as under a coat; only indenters of different sizes distinguish the two. The
radius is at least a tenth of the stated one. A mesh grows as a whole; its R is half the shortest side of its bounds.
"""

from __future__ import annotations

from dataclasses import replace

from skincal.effects.effect import InputEffect
from skincal.effects.parameter import Values, form, start, strength
from skincal.effects.samples import Samples, Setting
from skincal.model import Indenter

_REFERENCE_M, _SMALLEST = 5e-3, 0.1


class IndenterRadius(InputEffect):
    name = "indenter_radius"
    meaning = "the indenter is not the size the dataset says"
    equation_error = 0.0
    zero_error = 0.0
    parameters = (
        strength("scale", "-", 1.0, 0.3, 3.0, "s: true over said radius, at 5 mm", typical=0.5, scale="log"),
        form("coat", "-", 0.0, 0.0, 1.0, "w: how far it is a length that others are off by, too"),
    )
    search_from = tuple(start({"scale": 1.15, "coat": w}) for w in (0.0, 1.0))
    of_rig = True
    asks = ("indenters",)
    source = "Contact area of a sphere on an elastic foundation, a² = 2 R delta: Johnson, Contact Mechanics, 1985, 4.3."

    def apply(self, samples: Samples, values: Values, setting: Setting) -> Samples:
        """Return the samples with resized indenters (:meth:`InputEffect.apply`)."""
        scale, coat = values.number("scale"), values.number("coat")
        return replace(samples, indenters=tuple(_resized(thing, scale, coat) for thing in samples.indenters))


def _resized(indenter: Indenter, scale: float, coat: float) -> Indenter:
    return indenter.resized(max(1 + (scale - 1) * (_REFERENCE_M / indenter.radius_m) ** coat, _SMALLEST))
