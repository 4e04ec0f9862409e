"""The simulated hand: fingers, drives, joint sensors and skin, advanced together."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skincal.errors import WorkError
from skincal.model.arrays import FloatArray
from skincal.robot import HandDescription, HandState, Kinematics, contact_from_joints
from skincal.robot.kinematics import prepare_contacts
from skincal.sim.drives import DriveParameters, Drives
from skincal.sim.physics_client import Fingers, SimOptions
from skincal.sim.position_error import position_error
from skincal.sim.reference_skin import ReferenceSkin
from skincal.sim.touch import Look, SkinMemory, TrueContact, contact_stiffness, true_contact
from skincal.sim.truth import Truth

_TOUCH_N = 0.3
"""Smallest force of contacts that count for the position error of a session [N]."""


class SimulatedHand:
    """A hand in its own PyBullet client, independent of others.

    Args:
        description: the hand.
        truth: true parameters of its skin and joints.
        rng: generator of all noise.
        options: options of the physics.
        start_s: start of the hand's clock [s]: drifts of a resumed session continue.
        memory: contact history of the skin, to which new contacts are added; None: none.

    Attributes:
        image_contact: the true contact at the latest image.
    """

    image_contact: TrueContact

    def __init__(
        self,
        description: HandDescription,
        truth: Truth,
        rng: np.random.Generator,
        options: SimOptions | None = None,
        start_s: float = 0.0,
        memory: SkinMemory | None = None,
    ) -> None:
        options = options or SimOptions()
        self.description = description
        self.truth = truth
        self._memory, past = memory, memory.past if memory is not None else []
        self._touches = [look for look in past if look.contact.force_n > _TOUCH_N]
        self._options = options
        self._kinematics = Kinematics(description)
        self._rng, skin_rng = rng.spawn(2)
        self._skin = ReferenceSkin(self._kinematics, truth, skin_rng)
        # A driver's guard gives observe() little time, and compilation takes seconds.
        self._skin.prepare()
        prepare_contacts(self._kinematics)
        self._skin.remember([look.contact for look in past])
        elasticity, depth_n = truth.elasticity_pa_per_m, options.contact_depth_force_n
        stiffness = contact_stiffness(self._kinematics, elasticity, depth_n)
        drives = _drive_parameters(description, truth, options)
        self._drives = Drives(drives, description.home_rad, 1 / options.physics_hz)
        self._fingers = Fingers(description, options, stiffness)
        self._between = options.physics_hz // options.taxel_hz
        self._steps = round(start_s * options.taxel_hz) * self._between
        scan = np.linspace(-options.taxel_scan_s, 0.0, self._skin.taxels)
        self._scan_s = scan if self._skin.taxels > 1 else np.zeros(1)
        self._desired = self._measured_angles()
        # Some time passes before the first reading, so that there is an image.
        self.advance(self._between)

    @property
    def time_s(self) -> float:
        """The hand's clock [s]."""
        return self._steps / self._options.physics_hz

    def command(self, q_desired_rad: ArrayLike) -> None:
        """Set the target angles (n,) [rad], as the joint sensors measure them.

        Raises:
            WorkError: the number of angles is wrong, or one is not finite.
        """
        desired = np.array(q_desired_rad, dtype=np.float64)
        if desired.shape != self._desired.shape or not np.isfinite(desired).all():
            expected = f"{len(self._desired)} finite angles"
            raise WorkError(f"simulated hand: expected {expected}; got {q_desired_rad!r}")
        self._desired = desired

    def hold(self) -> None:
        """Hold the motors where they are: no new force arises, and the present force fades."""
        self._drives.hold()
        self._desired = self._measured_angles()

    def advance(self, steps: int) -> None:
        """Advance by some physics steps."""
        fingers, drives = self._fingers, self._drives
        # The controller sees angles with the sensors' errors, which change little in such a time.
        motors = drives.motor_rad
        drives.target_rad = self._desired - self.truth.joints.angle_error_rad(motors)
        q, dq = fingers.joints()
        for _ in range(steps):
            fingers.step(drives.step(q, dq))
            q, dq = fingers.joints()
            self._steps += 1
            if self._steps % self._between == 0:
                self._look()
        if not all(-1e3 < angle < 1e3 for angle in q):
            raise WorkError("simulated hand: expected finite joint angles; the simulation has diverged")

    def contact(self) -> TrueContact:
        """Return the present true contact."""
        q = np.array(self._fingers.joints()[0])
        return true_contact(self._kinematics, self.time_s, q, self._fingers.force())

    def reading(self) -> HandState:
        """Return the present readings of the sensors; every call draws new noise."""
        joints, count = self.truth.joints, len(self._desired)
        noise = self._rng.standard_normal((3, count))
        speed = self._drives.speed_rad_per_s
        tau = self._drives.torque_nm * joints.torque_scale + joints.torque_offset_nm
        return HandState(
            time_s=self.time_s,
            q_rad=self._measured_angles() + joints.noise_rad * noise[0],
            dq_rad_per_s=speed + joints.speed_noise_rad_per_s * noise[1],
            tau_nm=tau + joints.torque_noise_nm * noise[2],
            q_desired_rad=self._desired.copy(),
            taxels=self._image.copy(),
            taxel_time_s=self._image_time_s + self._scan_s,
        )

    def truth_dict(self) -> dict[str, Any]:
        """Return the truth as plain numbers, lists and texts, for a JSON file."""
        truth = self.truth
        return {
            "model": truth.model_dict(plane=self.description.meta.surface.is_plane),
            "skin": truth.skin_dict(),
            "effects": truth.effects_list(),
            "joints": truth.joints.as_dict(),
            "position_error": vars(position_error(self._kinematics, truth)),
            "session": self._session_dict(),
        }

    def _session_dict(self) -> dict[str, Any]:
        """Return the mean position error of the contacts so far, and the pose that includes it."""
        if not self._touches:
            return {"contacts": 0}
        looks = self._touches
        angles, torques = np.array([look.q_rad for look in looks]), np.array([look.tau_nm for look in looks])
        measured = contact_from_joints(self._kinematics, angles, torques)
        true = np.array([look.contact.point_m for look in looks])
        surface = self._kinematics.surface
        across, along = surface.unrolled(measured.points_m, true).mean(axis=0)
        pose = surface.moved_pose(self.truth.pose, float(across))
        shifted = replace(self.truth, pose=replace(pose, y_m=pose.y_m + float(along)))
        model = shifted.model_dict(plane=self.description.meta.surface.is_plane)
        return {
            "contacts": len(looks),
            "constant_position_error_m": {"across": float(across), "along": float(along)},
            "truth_as_the_positions_tell_it": {k: model[k] for k in ("y_m", "x_m", "beta_deg") if k in model},
        }

    def close(self) -> None:
        """Close the client and the contact history; may be called twice."""
        self._fingers.close()
        if self._memory is not None:
            self._memory.close()

    def _look(self) -> None:
        self.image_contact = contact = self.contact()
        look = Look(contact, self._measured_angles(), self._drives.torque_nm.copy())
        if contact.force_n > _TOUCH_N:
            self._touches.append(look)
        if self._memory is not None:
            self._memory.keep(look)
        self._image, self._image_time_s = self._skin.image(contact), contact.time_s

    def _measured_angles(self) -> FloatArray:
        """Return angles (n,) without noise where the hand measures them: at the motors, or at the links."""
        if self.description.compliance_rad_per_nm is None:
            q = np.array(self._fingers.joints()[0])
        else:
            q = self._drives.motor_rad.copy()
        return q + self.truth.joints.angle_error_rad(q)


def _drive_parameters(description: HandDescription, truth: Truth, options: SimOptions) -> DriveParameters:
    gains = description.gains
    return DriveParameters(
        stiffness_nm_per_rad=gains.stiffness_nm_per_rad,
        damping_nms_per_rad=gains.damping_nms_per_rad,
        low_pass_hz=gains.low_pass_hz,
        drive_stiffness_nm_per_rad=truth.joints.drive_stiffness_nm_per_rad,
        friction_nm=truth.joints.friction_nm,
        torque_limit_nm=description.limits.torque_nm,
        link_damping_nms_per_rad=options.link_damping_nms_per_rad,
    )
