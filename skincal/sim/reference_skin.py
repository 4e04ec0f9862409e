"""The skin of the simulated hand: the model at its true parameters, with effects, noise and the converter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.model_objects import converter_of, indenter_of, layout_of, surface_of
from skincal.effects import EffectSkin, Samples, SkinStream
from skincal.model import Patch, Skin, SkinParameters
from skincal.robot import Kinematics
from skincal.sim.presses import PressTracker
from skincal.sim.touch import TrueContact
from skincal.sim.truth import Truth

FloatArray = NDArray[np.float64]


class ReferenceSkin:
    """Turns true contacts into counts, one image after the other.

    Effects on pose and force act on the true ones: the skin feels something else than what presses, and than what the
    joints tell of.

    Args:
        kinematics: the hand.
        truth: pose and parameters.
        rng: noise of the taxels.
    """

    def __init__(self, kinematics: Kinematics, truth: Truth, rng: np.random.Generator) -> None:
        meta = kinematics.description.meta
        surface = surface_of(meta.surface, {})
        patch = Patch.build(surface, layout_of(meta.sensor, None), truth.pose)
        self._indenter = indenter_of(meta.indenter, {})
        self._skin = Skin(
            patch, SkinParameters(truth.elasticity_pa_per_m, truth.scale_per_n), converter_of(meta.sensor)
        )
        self._stream = SkinStream(EffectSkin.of(self._skin, surface, truth.effects))
        self._tracker = PressTracker(kinematics)
        self._truth = truth
        self._rng = rng

    @property
    def taxels(self) -> int:
        """Number of taxels."""
        return self._skin.patch.layout.taxels

    def image(self, contact: TrueContact) -> FloatArray:
        """The next tactile image (J,) [counts]; contacts come in the order of time."""
        noise = self._truth.noise_counts * self._rng.standard_normal(self.taxels)
        # Adding zero turns the converter's -0 into 0.
        return self._skin.converter.apply(self._values(contact) + noise) + 0.0

    def base_values(self, contact: TrueContact) -> FloatArray:
        """Values (J,) [counts] of the base model, without effects and noise, neither rounded nor clipped."""
        if not contact.touching:
            return np.full(self.taxels, self._truth.rest_counts)
        return self._truth.rest_counts + self._skin.values(self._indenter, contact.contacts())[0]

    def _values(self, contact: TrueContact) -> FloatArray:
        if not self._truth.effects:
            return self.base_values(contact)
        known = self._tracker.next(contact)
        samples = Samples.of(
            contact.contacts(),
            self._indenter,
            touching=[contact.touching],
            press=[known.press],
            time_s=[contact.time_s],
            phase=[known.phase],
            speed_m_per_s=[known.speed_m_per_s],
            cycle=[known.cycle],
            pose=[known.pose],
            temperature_c=[np.nan],
            shear_u_n=[contact.shear_u_n],
            shear_v_n=[contact.shear_v_n],
        )
        return self._truth.rest_counts + self._stream.step(samples)[0]
