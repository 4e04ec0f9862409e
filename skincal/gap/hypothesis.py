"""What is taken to be true of a session: the sensor, its effects, and where each press really was."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from skincal.effects import EffectSkin, Samples
from skincal.gap.base import BaseModel, centred
from skincal.inference.session import GapSession
from skincal.model.arrays import FloatArray, IntArray

Parameters = Mapping[str, FloatArray]

PLACE = 3
"""Numbers that a press has of its own: across [m], along [m], logarithm of its force."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A model of a session, down to the place of every press.

    Attributes:
        model: the base model.
        places: (P, 3) by how much presses are off: across [m], along [m], logarithm of true over measured force.
        effects: parameters by effect.
    """

    model: BaseModel
    places: FloatArray
    effects: Mapping[str, Parameters] = field(default_factory=dict[str, Parameters])

    @cached_property
    def skin(self) -> EffectSkin:
        """The skin, effects included."""
        return self.model.skin.with_effects(self.effects) if self.effects else self.model.skin

    def placed(self, session: GapSession) -> GapSession:
        """The session with its presses where they are taken to be."""
        return replace(session, samples=placed(self.skin, session.samples, session.row, self.places))

    def values(self, session: GapSession) -> FloatArray:
        """Observations (N, J) before the converter [counts]."""
        return session.means(self.skin.values(memory_samples(self, self.placed(session))))

    def moved(self, steps: FloatArray) -> Hypothesis:
        """Another sensor: steps (5,) across, along [m], alpha [rad], and logarithms of E and S."""
        model, pose = self.model, self.model.pose
        pose = replace(pose, alpha_rad=pose.alpha_rad + float(steps[2]))
        flat = replace(pose, alpha_rad=0.0)
        centre = model.surface.wrap(flat, np.array([[steps[0], steps[1]]]))[0][0]
        moved = replace(
            model,
            pose=centred(model.surface, pose, centre),
            elasticity_pa_per_m=model.elasticity_pa_per_m * float(np.exp(steps[3])),
            scale_per_n=model.scale_per_n * float(np.exp(steps[4])),
        )
        return replace(self, model=moved)

    def with_places(self, places: FloatArray) -> Hypothesis:
        """The same sensor with its presses elsewhere; its tactile points are kept."""
        other = replace(self, places=places)
        other.__dict__["skin"] = self.skin
        return other

    def with_effects(self, effects: Mapping[str, Parameters]) -> Hypothesis:
        """The same sensor with other effects."""
        return replace(self, effects=dict(effects))


def memory_samples(hypothesis: Hypothesis, session: GapSession) -> Samples:
    """The samples to run through the chain: without frames, presses do not remember each other."""
    return session.remembered if hypothesis.skin.has_memory else session.samples


def placed(skin: EffectSkin, samples: Samples, row: IntArray, places: FloatArray) -> Samples:
    """Samples with each press moved [m] and its force changed.

    Args:
        skin: on whose surface.
        samples: K of them.
        row: (K,) row of the press of each, -1 at rest.
        places: (P, 3) as of :class:`Hypothesis`.
    """
    own = np.where((row >= 0)[:, None], places[np.maximum(row, 0)], 0.0)
    moved = skin.setting.moved(samples, own[:, 0], own[:, 1])
    contacts = moved.contacts
    return replace(moved, contacts=replace(contacts, force_n=contacts.force_n * np.exp(own[:, 2])))
