"""A glove carries part of the force before the skin feels it.

    F_skin = F - F_c (1 - exp(-s F / F_c))

At first the glove carries the share s of every newton. What it carries levels off at F_c, as with a fabric stretched
over the fingertip until it lies on the skin. A share that never levels off is not identifiable: it acts like the scale.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.effects.effect import InputEffect
from skincal.effects.parameter import EffectParameter, Values
from skincal.effects.samples import Samples
from skincal.effects.setting import Setting
from skincal.effects.starts import Scene, Start, start


class Cover(InputEffect):
    """The effect ``cover``, with the equation of the module."""

    name = "cover"
    meaning = "a glove carries part of the force before the skin feels it"
    parameters = (
        EffectParameter("carried_n", "N", 0.0, 0.0, 3.0, "the most that the glove carries", typical=0.4),
        EffectParameter(
            "share", "-", 0.9, 0.05, 1.0, "part of the first newton that it carries", role="form"
        ),
    )
    asks = ("forces",)
    source = "Parallel springs of which one yields: Jenkins, Br. J. Appl. Phys. 13 (1962) 30; here smooth."

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        """See :meth:`Effect.starts`."""
        del scene
        return tuple(start({"carried_n": 0.2, "share": s}) for s in (0.9, 0.4))

    def apply(self, samples: Samples, values: Values, setting: Setting) -> Samples:
        """See :meth:`InputEffect.apply`."""
        del setting
        carried, share = values.number("carried_n"), values.number("share")
        force = samples.contacts.force_n
        pressing = np.maximum(force, 0.0)
        felt = force + carried * np.expm1(-share * pressing / carried)
        return replace(samples, contacts=replace(samples.contacts, force_n=felt))
