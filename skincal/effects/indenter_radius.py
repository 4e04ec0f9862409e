"""The indenter is not the size that the dataset says.

    R = s R_said

for a sphere or a flat punch; it still touches at the same place. The radius of a mesh is not a number: there the
effect is refused.
"""

from __future__ import annotations

from dataclasses import replace

from skincal.effects.base import InputEffect
from skincal.effects.parameter import EffectParameter, Values
from skincal.effects.samples import Samples
from skincal.effects.setting import Setting
from skincal.errors import InputError, Problem
from skincal.model import FlatPunch, Indenter, Sphere


class IndenterRadius(InputEffect):
    """See the module."""

    name = "indenter_radius"
    meaning = "the indenter is not the size the dataset says"
    parameters = (
        EffectParameter("scale", "-", 1.0, 0.3, 3.0, "true over said radius", typical=0.5, scale="log"),
    )
    of_rig = True
    source = "Contact area of a sphere on an elastic foundation, a² = 2 R delta: Johnson, Contact Mechanics, 1985, 4.3."

    def apply(self, samples: Samples, values: Values, setting: Setting) -> Samples:
        """See :meth:`InputEffect.apply`.

        Raises:
            InputError: an indenter that has no radius.
        """
        del setting
        scale = values.number("scale")
        return replace(samples, indenters=tuple(_scaled(thing, scale) for thing in samples.indenters))


def _scaled(indenter: Indenter, scale: float) -> Indenter:
    if isinstance(indenter, Sphere):
        return Sphere(scale * indenter.radius_m)
    if isinstance(indenter, FlatPunch):
        return FlatPunch(scale * indenter.radius_m)
    raise InputError([Problem("effect indenter_radius", "a sphere or a flat punch", type(indenter).__name__)])
