"""The skin of an episode: the model at the values drawn, with effects, offsets, noise and the converter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skincal.calibration import MARGIN_M
from skincal.calibration.parts import LAW
from skincal.dataset.dataset import converter_of, layout_of
from skincal.effects import EffectSkin, Samples, SkinStream
from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.envs.bodies import Body
from skincal.envs.drawing import Values, array, effects_of, number
from skincal.envs.pinch import Pinch
from skincal.model import ContactLaw, Contacts, Patch, SensorPose, Skin, SkinParameters
from skincal.model.arrays import FloatArray

RESOLUTION_M = 0.25e-3
"""Longest edge of a tactile point's cell, unless another is asked for [m]."""
SESSION_S = 600.0
"""A session has gone on for so long at most when an episode begins; what drifts has drifted by then [s]."""
_LOADING_M_PER_S = 0.01
"""Speed at which the object is taken to have been pressed on the skin [m/s]."""
_STEADY_N_PER_S = 0.4
"""Forces that change slower are held [N/s]."""
_NOTHING = Contacts(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.zeros(1))


def drawn_age_s(rng: np.random.Generator) -> float:
    """Return for how long a session has gone on when an episode begins [s]."""
    return float(rng.uniform(0.0, SESSION_S))


@dataclass(frozen=True, eq=False)
class SkinContact:
    """A contact as the skin feels it, fingertip frame.

    Attributes:
        contacts: one contact, or one for each of several objects alike.
        shear_u_n: tangential force on the skin towards growing beta [N].
        shear_v_n: tangential force along +y [N].
    """

    contacts: Contacts
    shear_u_n: float
    shear_v_n: float


class TactileSkin:
    """Makes tactile images, one after the other; begin an episode with :meth:`begin`."""

    def __init__(self, pinch: Pinch, resolution_m: float = RESOLUTION_M) -> None:
        meta = pinch.description.meta
        self._surface = pinch.surface
        self._converter = converter_of(meta.sensor)
        self.layout = layout_of(meta.sensor, None)
        self._resolution_m = resolution_m

    @cached_property
    def _cells(self) -> Patch:
        """Cells of the patch, built at first use: policies without touch never need them."""
        # Always at the same pose: the order of sums must not depend on what was asked for before.
        return Patch.build(self._surface, self.layout, SensorPose(0.0, 0.0), self._resolution_m, MARGIN_M)

    def patch(self, pose: SensorPose) -> Patch:
        """Return the patch at a pose: that of :meth:`skincal.model.Patch.build`, made by moving the same cells.

        Its compact tiles are those found at one pose, as neighbours stay neighbours.
        """
        assert self._cells.uv_m is not None
        return self._cells.moved(*self._surface.wrap(pose, self._cells.uv_m))

    @property
    def taxels(self) -> int:
        """Number of taxels J."""
        return self.layout.taxels

    @property
    def range_counts(self) -> tuple[float, float]:
        """Smallest and largest count; what a converter that does not clip is taken to give."""
        low, high = self._converter.value_min, self._converter.value_max
        return -1e4 if low is None else low, 1e4 if high is None else high

    def begin(self, values: Values, pose: SensorPose, body: Body, age_s: float) -> None:
        """Begin an episode."""
        scale = np.maximum(number(values, "skin.scale_per_n") + array(values, "skin.scale_offset_per_n"), 0.0)
        parameters = SkinParameters(number(values, "skin.elasticity_pa_per_m"), scale)
        names = (*LAW, "reference_radius_m")
        law = ContactLaw(**{name: number(values, f"skin.contact_law.{name}") for name in names})
        neutral = law == ContactLaw()
        self._skin = Skin(self.patch(pose), parameters, self._converter, contact=None if neutral else law)
        self._body = body
        self._offset = array(values, "skin.taxel_offset_counts")
        effects = effects_of(values)
        self._stream = None
        if effects:
            some = EffectSkin.of(self._skin, self._surface, effects, missing="abstain")
            self._stream = SkinStream(some)
        self._age_s, self._before = age_s, (0.0, 0.0)

    def prepare(self) -> None:
        """Make the first touch as fast as all others; see :meth:`skincal.model.Skin.prepare`."""
        self._skin.prepare(self._body.indenter)

    def image(self, contact: SkinContact | None, time_s: float, noise_counts: FloatArray) -> FloatArray:
        """Return the next tactile image (J,) [counts]."""
        counts = self._values(contact, time_s) + self._offset + noise_counts
        # Adding zero turns the converter's -0 into 0; observations make of NaN a 0.
        return self._converter.apply(counts) + 0.0

    def _values(self, contact: SkinContact | None, time_s: float) -> FloatArray:
        if self._stream is not None:
            return self._stream.step(self._samples(contact, time_s))[0]
        if contact is None:
            return np.zeros(self.taxels)
        values = self._skin.values(self._body.indenter, contact.contacts)
        # Contacts that lie apart press on tactile points of their own.
        return values[0] if len(values) == 1 else values.sum(axis=0)

    def _samples(self, contact: SkinContact | None, time_s: float) -> Samples:
        """Return the contact with the covariates that effects need.

        A skin in use has been touched everywhere before: the cycle is not known, and what fades with it has faded.
        """
        touching = contact is not None
        samples = Samples.of(
            contact.contacts if touching else _NOTHING,
            self._body.indenter,
            touching=[touching],
            press=[0 if touching else -1],
            complete=True,
            time_s=[self._age_s + time_s],
            phase=[self._phase(contact, time_s)],
            speed_m_per_s=[_LOADING_M_PER_S],
            cycle=[np.nan],
            met_n=[np.nan],
            pose=[-1],
            temperature_c=[np.nan],
            shear_u_n=[contact.shear_u_n if touching else 0.0],
            shear_v_n=[contact.shear_v_n if touching else 0.0],
        )
        return replace(samples, start_s=0.0)

    def _phase(self, contact: SkinContact | None, time_s: float) -> int:
        """Return whether the force rises, falls or stays."""
        before, self._before = (
            self._before,
            (time_s, 0.0 if contact is None else float(contact.contacts.force_n[0])),
        )
        if contact is None:
            return IDLE
        passed = self._before[0] - before[0]
        change = (self._before[1] - before[1]) / passed if passed > 0 else 0.0
        if abs(change) < _STEADY_N_PER_S:
            return HOLD
        return LOAD if change > 0 else UNLOAD
