"""A glove carries part of the force before the skin feels it.

    F_skin = F - F_c (1 - exp(-s F / F_c))

At first the glove carries the share s of every newton. What it carries levels off at F_c, as with a fabric stretched
over the fingertip until it lies on the skin. A share that never levels off is not identifiable: it acts like the scale.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.effects.effect import InputEffect
from skincal.effects.parameter import Values, form, start, strength
from skincal.effects.samples import Samples, Setting


class Cover(InputEffect):
    name = "cover"
    errs_over = "place"
    meaning = "a glove carries part of the force before the skin feels it"
    parameters = (
        strength("carried_n", "N", 0.0, 0.0, 3.0, "the most that the glove carries", typical=0.4),
        form("share", "-", 0.9, 0.05, 1.0, "part of the first newton that it carries"),
    )
    search_from = tuple(start({"carried_n": 0.2, "share": s}) for s in (0.9, 0.4))
    asks = ("forces",)
    source = "Parallel springs of which one yields: Jenkins, Br. J. Appl. Phys. 13 (1962) 30; here smooth."

    def apply(self, samples: Samples, values: Values, setting: Setting) -> Samples:
        carried, share = values.number("carried_n"), values.number("share")
        force = samples.contacts.force_n
        pressing = np.maximum(force, 0.0)
        felt = force + carried * np.expm1(-share * pressing / carried)
        return replace(samples, contacts=replace(samples.contacts, force_n=felt))
