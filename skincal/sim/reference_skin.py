"""The skin of the simulated hand: the model at its true parameters, with effects, noise and the converter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from skincal.dataset.dataset import converter_of, indenter_of, layout_of, surface_of
from skincal.effects import EffectSkin, Samples, SkinStream
from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.model import Contacts, Patch, Skin, SkinParameters
from skincal.model.arrays import FloatArray
from skincal.robot import Kinematics
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
        known = map(self._tracker.next, contacts)
        press, phase, speed_m_per_s, cycle, met_n, pose = zip(*known, strict=True)
        return Samples.of(
            Contacts(
                np.array([contact.point_m for contact in contacts]),
                np.array([contact.normal for contact in contacts]),
                np.array([contact.force_n for contact in contacts]),
            ),
            self._indenter,
            touching=[contact.touching for contact in contacts],
            press=press,
            complete=True,
            time_s=[contact.time_s for contact in contacts],
            phase=phase,
            speed_m_per_s=speed_m_per_s,
            cycle=cycle,
            met_n=met_n,
            pose=pose,
            temperature_c=np.nan,
            shear_u_n=[contact.shear_u_n for contact in contacts],
            shear_v_n=[contact.shear_v_n for contact in contacts],
        )


SITE_M = 1e-3
"""Largest distance of touches of one site [m]."""
POSE_RAD = 0.06
"""Largest difference in angles of the finger with the skin within one hand pose [rad]."""
APART_S = 0.2
"""Longest loss of contact within one press [s]."""
STEADY_N_PER_S = 0.4
"""Largest change of a force that counts as held [N/s]."""


class Covariates(NamedTuple):
    """Covariates of one sample; see :class:`skincal.effects.Samples`."""

    press: int
    phase: int
    speed_m_per_s: float
    cycle: float
    met_n: float
    pose: int


class PressTracker:
    """Tracker that numbers presses, counts earlier touches of a site, and detects poses and phases."""

    def __init__(self, kinematics: Kinematics) -> None:
        self._skin_joints = kinematics.skin.columns
        self._sites: list[FloatArray] = []
        self._peaks_n: list[float] = []
        self._poses: list[FloatArray] = []
        self._press = -1
        self._pose, self._cycle, self._met_n, self._speed = -1, 0, 0.0, float("nan")
        self._last: TrueContact | None = None
        self._closing_m_per_s = 0.0
        self._touched_s = -np.inf

    def next(self, contact: TrueContact) -> Covariates:
        """Return the covariates of the next sample."""
        if contact.touching and contact.time_s - self._touched_s > APART_S:
            self._begin(contact)
        phase = self._phase(contact)
        self._closing_m_per_s = self._change(contact, "gap_m", sign=-1.0)
        self._last = contact
        if not contact.touching:
            return Covariates(-1, IDLE, float("nan"), float("nan"), float("nan"), self._pose)
        self._touched_s = contact.time_s
        self._peaks_n[-1] = max(self._peaks_n[-1], contact.force_n)
        return Covariates(self._press, phase, self._speed, float(self._cycle), self._met_n, self._pose)

    def _begin(self, contact: TrueContact) -> None:
        """Start a press: record its site, earlier touches, pose and speed."""
        self._press += 1
        near = [np.linalg.norm(site - contact.point_m) < SITE_M for site in self._sites]
        self._cycle = int(np.sum(near))
        self._met_n = max((peak for peak, same in zip(self._peaks_n, near, strict=True) if same), default=0.0)
        self._sites.append(contact.point_m)
        self._peaks_n.append(0.0)
        angles = contact.q_rad[self._skin_joints]
        same = [i for i, pose in enumerate(self._poses) if np.abs(pose - angles).max() < POSE_RAD]
        if not same:
            self._poses.append(angles)
        self._pose = same[0] if same else len(self._poses) - 1
        # Use the speed before the touch: afterwards the skin slows the indenter down.
        self._speed = max(self._closing_m_per_s, 0.0)

    def _phase(self, contact: TrueContact) -> int:
        if not contact.touching:
            return IDLE
        change = self._change(contact, "force_n", sign=1.0)
        if abs(change) < STEADY_N_PER_S:
            return HOLD
        return LOAD if change > 0 else UNLOAD

    def _change(self, contact: TrueContact, name: str, sign: float) -> float:
        """Return the rate of change since the last sample; 0 at the first."""
        last = self._last
        if last is None or contact.time_s <= last.time_s:
            return 0.0
        return sign * float(getattr(contact, name) - getattr(last, name)) / (contact.time_s - last.time_s)
