"""Samples of the hand by period, on the session's clock, and the loop that commands it and stores them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skincal.errors import WorkError
from skincal.hand.driver import HandState
from skincal.hand.guard import GuardedHand
from skincal.hand.loop import ControlLoop
from skincal.model.arrays import FloatArray
from skincal.robot import JointContact, Kinematics, contact_from_joints
from skincal.robot.kinematics import prepare_contacts

LARGEST_TARE_N = 3.0
"""Largest force that torques at rest may correspond to; beyond, something touches, or a sensor is broken."""


@dataclass(frozen=True, eq=False)
class Sample:
    """A state of the hand, with the contact inferred from its joints.

    Attributes:
        force_n: normal force without the torques at rest [N].
        shear_u_n: force on the skin towards growing beta [N].
        shear_v_n: force on the skin along +y [N].
        point_m: point of the surface nearest to the indenter, fingertip frame (3,) [m].
        height_m: height of the indenter above the surface [m].
        links_rad: angles of the links (n,) [rad].
        frame_s: mean time of the responding taxels' reading, session clock [s]; NaN without a reading.
    """

    time_s: float
    force_n: float
    shear_u_n: float
    shear_v_n: float
    point_m: FloatArray
    height_m: float
    links_rad: FloatArray
    state: HandState
    frame_s: float


class Senses:
    """Converter of states to samples: contact from joints, the session's clock, torques at rest."""

    def __init__(self, kinematics: Kinematics, indenter_radius_m: float) -> None:
        self._kinematics = kinematics
        self._radius_m = indenter_radius_m
        self._last: Sample | None = None
        self._shift_s = 0.0
        self.tare_nm: FloatArray = np.zeros(len(kinematics.description.joints))
        prepare_contacts(kinematics)

    def shift_clock(self, shift_s: float) -> None:
        """Set the difference of the session's clock from the hand's [s]."""
        self._shift_s, self._last = shift_s, None

    def contact_force(self, state: HandState) -> float:
        """Return the size of the contact force of a state [N], including its shear, for the guard."""
        sample = self.sample(state)
        return math.hypot(sample.force_n, sample.shear_u_n, sample.shear_v_n)

    def sample(self, state: HandState) -> Sample:
        """Return the sample of a state; a repeated call is cached."""
        if self._last is not None and self._last.state is state:
            return self._last
        torque = state.tau_nm - self.tare_nm
        contact = self._contact(state, torque)
        links = self._kinematics.link_angles(state.q_rad, torque)[0]
        times = state.taxel_time_s[np.isfinite(state.taxel_time_s)]
        frame_s = float(times.mean()) if len(times) else math.nan
        self._last = Sample(
            state.time_s + self._shift_s, float(contact.force_n[0]), float(contact.shear_u_n[0]),
            float(contact.shear_v_n[0]), contact.points_m[0], float(contact.gap_m[0]), links, state,
            frame_s + self._shift_s,
        )  # fmt: skip
        return self._last

    def _contact(self, state: HandState, torque_nm: FloatArray) -> JointContact:
        return contact_from_joints(self._kinematics, state.q_rad, torque_nm, indenter_radius_m=self._radius_m)

    def take_tare(self, samples: list[Sample]) -> None:
        """Use the mean torques of samples without contact as the torques at rest.

        Raises:
            WorkError: they correspond to a force that no offset explains.
        """
        if not samples:
            return
        tare = np.mean([sample.state.tau_nm for sample in samples], axis=0)
        force = float(self._contact(samples[-1].state, tare).total_n[0])
        if not force < LARGEST_TARE_N:
            raise WorkError(
                f"torques at rest: expected less than what {LARGEST_TARE_N:g} N of contact would need; got those of "
                f"{force:.3g} N with the indenter {1e3 * samples[-1].height_m:.1f} mm above the skin. Does something "
                "else touch the fingers, or is a torque sensor off?"
            )
        self.tare_nm = tare
        self._last = None


class Loop(ControlLoop[GuardedHand, Sample]):
    """Control loop of a hand with its senses."""

    def __init__(
        self, hand: GuardedHand, senses: Senses, watch: Callable[[Sample, str], None] | None = None
    ) -> None:
        super().__init__(hand, watch)
        self.senses = senses

    def _sample(self, state: HandState) -> Sample:
        return self.senses.sample(state)
