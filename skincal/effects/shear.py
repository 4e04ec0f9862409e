"""A tangential force moves or changes the image.

    (across, along) += s Q,    F_skin = F + c |Q|

with Q the tangential force: the soft skin yields by s metres a newton under it and carries the contact along, and a
part c of it adds to what the taxels feel, as they answer to any strain. Q is measured along growing beta and along +y.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.effects.base import InputEffect
from skincal.effects.parameter import EffectParameter, Values
from skincal.effects.samples import Samples
from skincal.effects.setting import Setting


class Shear(InputEffect):
    """See the module."""

    name = "shear"
    meaning = "a tangential force moves or changes the image"
    parameters = (
        EffectParameter(
            "shift_m_per_n", "m/N", 0.0, -3e-3, 3e-3, "how far the contact is carried along", typical=0.6e-3
        ),
        EffectParameter(
            "force_share", "-", 0.0, -1.0, 1.0, "part of |Q| that adds to the force", typical=0.15
        ),
    )
    covariates = ("shear",)
    source = "Tangential compliance of a foundation: Kalker, Three-Dimensional Elastic Bodies, 1990, simplified theory."

    def apply(self, samples: Samples, values: Values, setting: Setting) -> Samples:
        """See :meth:`InputEffect.apply`. A sample without a tangential force counts as having none."""
        assert samples.shear_n is not None
        shear = np.where(np.isfinite(samples.shear_n), samples.shear_n, 0.0)
        force = samples.contacts.force_n
        added = np.maximum(force + values["force_share"] * np.hypot(shear[:, 0], shear[:, 1]), 0.0)
        felt = np.where(samples.touching & (force > 0), added, force)
        moved = setting.moved(samples, *(values.number("shift_m_per_n") * shear.T))
        return replace(moved, contacts=replace(moved.contacts, force_n=felt))
