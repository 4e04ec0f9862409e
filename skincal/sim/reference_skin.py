"""The skin of the simulated hand: the model at its true parameters, with noise and the converter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.model_objects import converter_of, indenter_of, layout_of, surface_of
from skincal.model import Patch, Skin, SkinParameters
from skincal.robot import HandDescription
from skincal.sim.touch import TrueContact
from skincal.sim.truth import Truth

FloatArray = NDArray[np.float64]


class ReferenceSkin:
    """Turns true contacts into counts, one image after the other.

    Args:
        description: the hand.
        truth: pose and parameters.
        rng: noise of the taxels.
    """

    def __init__(self, description: HandDescription, truth: Truth, rng: np.random.Generator) -> None:
        meta = description.meta
        patch = Patch.build(surface_of(meta.surface, {}), layout_of(meta.sensor, None), truth.pose)
        self._indenter = indenter_of(meta.indenter, {})
        self._skin = Skin(
            patch, SkinParameters(truth.elasticity_pa_per_m, truth.scale_per_n), converter_of(meta.sensor)
        )
        self._truth = truth
        self._rng = rng

    @property
    def taxels(self) -> int:
        """Number of taxels."""
        return self._skin.patch.layout.taxels

    def image(self, contact: TrueContact) -> FloatArray:
        """The next tactile image (J,) [counts]."""
        # Adding zero turns the converter's -0 into 0.
        return self._skin.converter.apply(self.values(contact) + self._noise()) + 0.0

    def values(self, contact: TrueContact) -> FloatArray:
        """Values (J,) [counts] without noise, neither rounded nor clipped."""
        if not contact.touching:
            return np.full(self.taxels, self._truth.rest_counts)
        return self._truth.rest_counts + self._skin.values(self._indenter, contact.contacts())[0]

    def _noise(self) -> FloatArray:
        return self._truth.noise_counts * self._rng.standard_normal(self.taxels)
