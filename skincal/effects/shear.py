"""A tangential force moves or changes the image.

    (across, along) += s Q (F / 1 N)^-p / (1 + b |Q|),    F_skin = F + c |Q|

with Q the tangential force: the soft skin yields by s metres per newton and carries the contact along, and a part c of
Q adds to what the taxels feel, as they respond to any strain. Q is measured along growing beta and along +y. On a
foundation p is zero. A ball on a thick layer is held better the larger the contact, whose radius grows with the third
root of the force, and p is a third (Mindlin 1949). With p = 1 only the direction of the force counts. Rubber stiffens
as its chains are stretched (Gent 1996): here in the simplest equation with a limit, s / b at 1 N; b is zero without
one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.effects.effect import InputEffect
from skincal.effects.parameter import Values, form, start, strength
from skincal.effects.samples import Samples, Setting

_LEAST_N = 0.1
"""Force below which a contact holds no worse [N]: its power has no limit at zero, where Q is noise."""


class Shear(InputEffect):
    name = "shear"
    errs_over = "place"
    meaning = "a tangential force moves or changes the image"
    parameters = (
        strength("shift_m_per_n", "m/N", 0.0, -6e-3, 6e-3, "s: shift for a little Q, at 1 N", typical=0.6e-3),
        strength("force_share", "-", 0.0, -1.0, 1.0, "c: part of |Q| that adds to the force", typical=0.15),
        form("load_exponent", "-", 0.0, 0.0, 1.0, "p: how much less is carried along under load"),
        form("stiffening_per_n", "1/N", 0.0, 0.0, 5.0, "b: how much less is carried along the larger Q is"),
    )
    search_from = tuple(
        start({"shift_m_per_n": 3e-4, "load_exponent": p}, {"force_share": 0.1, "load_exponent": p})
        for p in (0.0, 1 / 3, 1.0)
    )
    covariates = ("shear",)
    asks = ("shear",)
    shows = "places"
    source = (
        "Tangential compliance of a foundation: Kalker, Three-Dimensional Elastic Bodies, 1990, simplified theory; "
        "of a ball on a half-space: Mindlin, Compliance of elastic bodies in contact, J. Appl. Mech. 16 (1949); rubber "
        "with a limit: Gent, A new constitutive relation for rubber, Rubber Chem. Technol. 69 (1996)."
    )

    def apply(self, samples: Samples, values: Values, setting: Setting) -> Samples:
        """Return the samples (:meth:`InputEffect.apply`). A sample without a tangential force counts as having none."""
        assert samples.shear_n is not None
        shear = np.where(np.isfinite(samples.shear_n), samples.shear_n, 0.0)
        force = samples.contacts.force_n
        size = np.hypot(shear[:, 0], shear[:, 1])
        added = np.maximum(force + values["force_share"] * size, 0.0)
        felt = np.where(samples.touching & (force > 0), added, force)
        held = np.maximum(np.nan_to_num(force), _LEAST_N) ** -values.number("load_exponent")
        held /= 1.0 + values.number("stiffening_per_n") * size
        moved = setting.moved(samples, *(values.number("shift_m_per_n") * held * shear.T))
        return replace(moved, contacts=replace(moved.contacts, force_n=felt))
