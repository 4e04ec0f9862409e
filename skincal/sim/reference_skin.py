"""The skin of the simulated hand: the model at its true parameters, with effects, noise and the converter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.dataset.model_objects import converter_of, indenter_of, layout_of, surface_of
from skincal.effects import EffectSkin, Samples, SkinStream
from skincal.model import Contacts, Patch, Skin, SkinParameters
from skincal.model.arrays import FloatArray
from skincal.robot import Kinematics
from skincal.sim.presses import PressTracker
from skincal.sim.touch import TrueContact
from skincal.sim.truth import Truth

_AT_ONCE = 256


class ReferenceSkin:
    """Converter of true contacts to counts, one image after the other.

    Effects on pose and force act on the true ones: the skin feels another contact than the true one, and than the one
    inferred from the joints.
    """

    def __init__(self, kinematics: Kinematics, truth: Truth, rng: np.random.Generator) -> None:
        meta = kinematics.description.meta
        surface = surface_of(meta.surface, {})
        patch = Patch.build(surface, layout_of(meta.sensor, None), truth.pose)
        self._indenter = indenter_of(meta.indenter, {})
        parameters = SkinParameters(truth.elasticity_pa_per_m, truth.scale_per_n)
        self._skin = Skin(patch, parameters, converter_of(meta.sensor), contact=truth.contact_law)
        self._stream = SkinStream(EffectSkin.of(self._skin, surface, truth.effects))
        self._tracker = PressTracker(kinematics)
        self._truth = truth
        self._rng = rng

    @property
    def taxels(self) -> int:
        """Number of taxels."""
        return self._skin.patch.layout.taxels

    def prepare(self) -> None:
        """Compile, so that the first touch is as fast as the others; see :meth:`skincal.model.Skin.prepare`."""
        self._skin.prepare(self._indenter)

    def image(self, contact: TrueContact) -> FloatArray:
        """Return the next tactile image (J,) [counts]; contacts must come in the order of time."""
        noise = self._truth.noise_counts * self._rng.standard_normal(self.taxels)
        # Adding zero turns the converter's -0 into 0.
        return self._skin.converter.apply(self._values(contact) + noise) + 0.0

    def base_values(self, contact: TrueContact) -> FloatArray:
        """Return the values (J,) [counts] of the base model, without effects and noise, neither rounded nor clipped."""
        if not contact.touching:
            return np.full(self.taxels, self._truth.rest_counts)
        return self._truth.rest_counts + self._skin.values(self._indenter, contact.contacts())[0]

    def remember(self, contacts: Sequence[TrueContact]) -> None:
        """Replay earlier contacts, so that the effects continue as if there had been no break."""
        if self._truth.effects:
            for first in range(0, len(contacts), _AT_ONCE):
                self._stream.step(self._samples(contacts[first : first + _AT_ONCE]))

    def _values(self, contact: TrueContact) -> FloatArray:
        if not self._truth.effects:
            return self.base_values(contact)
        return self._truth.rest_counts + self._stream.step(self._samples([contact]))[0]

    def _samples(self, contacts: Sequence[TrueContact]) -> Samples:
        """Return the contacts as samples that follow the earlier ones, with the covariates of the effects."""
        known = [self._tracker.next(contact) for contact in contacts]
        return Samples.of(
            Contacts(
                np.array([contact.point_m for contact in contacts]),
                np.array([contact.normal for contact in contacts]),
                np.array([contact.force_n for contact in contacts]),
            ),
            self._indenter,
            touching=[contact.touching for contact in contacts],
            press=[covariates.press for covariates in known],
            time_s=[contact.time_s for contact in contacts],
            phase=[covariates.phase for covariates in known],
            speed_m_per_s=[covariates.speed_m_per_s for covariates in known],
            cycle=[covariates.cycle for covariates in known],
            met_n=[covariates.met_n for covariates in known],
            pose=[covariates.pose for covariates in known],
            temperature_c=np.nan,
            shear_u_n=[contact.shear_u_n for contact in contacts],
            shear_v_n=[contact.shear_v_n for contact in contacts],
        )
