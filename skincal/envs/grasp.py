"""Grasp at the start of an episode: the object is held between the tips, which close until both touch it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.envs.bodies import Body
from skincal.envs.drawing import Values, array, number
from skincal.envs.pinch import Pinch
from skincal.envs.postures import Postures
from skincal.envs.scene import PHYSICS_HZ, Grip, Placed, Scene
from skincal.model.arrays import FloatArray
from skincal.sim.drives import DriveParameters


@dataclass(frozen=True)
class GraspOptions:
    """Options of the grasp; all of them are assumed.

    Attributes:
        gap_m: distance of each tip to the object at first [m].
        wider_m: by so much the tips open further if one of them would begin inside the object [m].
        closing_m_per_s: how fast the tips approach each other [m/s].
        squeeze_n: normal force that is commanded once both touch [N].
        squeeze_s: time over which that force comes up [s].
        settle_s: time for the grasp to come to rest [s].
        stiffness_at_n: the contact's spring constant is force over depth of the skin at this force [N].
        link_damping_nms_per_rad: damping in the drives' elasticity [N m s/rad].
    """

    gap_m: float = 0.006
    wider_m: float = 0.004
    closing_m_per_s: float = 0.15
    squeeze_n: float = 1.5
    squeeze_s: float = 0.08
    settle_s: float = 0.06
    stiffness_at_n: float = 5.0
    damping_ns_per_m: float = 5.0
    link_damping_nms_per_rad: float = 0.01


_LOOK_STEPS = 4
"""Physics steps between looks for contact while the tips close."""


class Grasp:
    """Lets a hand take an object, through its postures."""

    def __init__(self, pinch: Pinch, nominal: Values, options: GraspOptions) -> None:
        self._pinch = pinch
        self.postures = Postures.of(pinch)
        self._options = options
        self._first = pinch.joints_of(slice(0, 2))
        self._last = pinch.joints_of(slice(2, 3))
        usual = self._drives(nominal)
        self._stiffness, self._friction = usual.stiffness_nm_per_rad, usual.friction_nm

    def take(
        self, scene: Scene, values: Values, body: Body, rotation: FloatArray, *places_m: FloatArray
    ) -> FloatArray:
        """Begin an episode: the object is held midway between the tips until both touch it, then let go.

        Args:
            scene: is built anew.
            values: the episode's draws.
            body: the object.
            rotation: (3, 3) from its frame to the fingertip's.
            places_m: (3,) offset from the middle, fingertip frame [m]; one for each of several objects alike.

        Returns:
            (n,) the command at which it is held, as the joint sensors measure it [rad].
        """
        width = self.open(scene, values, body, rotation, *places_m)
        return self._close(scene, width, values, single=len(places_m) == 1)

    def open(
        self, scene: Scene, values: Values, body: Body, rotation: FloatArray, *places_m: FloatArray
    ) -> float:
        """Begin a scene with the tips open about an object held between them; return their distance [m].

        Arguments are those of :meth:`take`.
        """
        options, offset = self._options, array(values, "finger.joint_offset_rad")
        width = 2 * (body.radius_m + options.gap_m)
        middle, tip = self._middle(self.postures.at(2 * body.radius_m) - offset)
        while True:
            command = self.postures.at(width)
            objects = tuple(Placed(body, middle + tip @ place, tip @ rotation) for place in places_m)
            scene.begin(self._grip(values, command - offset, objects))
            if scene.gap_m() > 0 or width >= self.postures.widths_m[-1]:
                return width
            width += options.wider_m

    def _middle(self, q_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the point midway between the two tips as they would hold the object, and the fingertip's rotation."""
        out, centre, thumb_end = self._pinch.facing
        skin, thumb = self._pinch.kinematics.frames(q_rad)
        foot, end = skin.to_root(centre)[0], thumb.to_root(thumb_end)[0]
        face = end - self._pinch.thumb.radius_m * (skin.rotations[0] @ out)
        return (foot + face) / 2, skin.rotations[0]

    def _close(self, scene: Scene, width_m: float, values: Values, *, single: bool) -> FloatArray:
        """Close the tips until both touch, then squeezes; gives up at the narrowest posture.

        Several objects are let go when they have been squeezed: the first that is touched would carry all alone.
        """
        options, offset = self._options, array(values, "finger.joint_offset_rad")
        command, width = self.postures.at(width_m), width_m
        while scene.held and width > self.postures.widths_m[0]:
            width -= options.closing_m_per_s * _LOOK_STEPS / PHYSICS_HZ
            command = self.postures.at(width)
            scene.drives.target_rad = command - offset
            scene.run(_LOOK_STEPS)
            if None not in scene.touches():
                if single:
                    scene.release()
                command = self._squeeze(scene, command, offset)
                if scene.held:
                    scene.release()
        scene.run(round(options.settle_s * PHYSICS_HZ))
        return command

    def _squeeze(self, scene: Scene, command_rad: FloatArray, offset_rad: FloatArray) -> FloatArray:
        """Let the normal force come up; returns the command that holds it.

        The torques J^T F of both fingers, by the hand's own figures of stiffness and friction. Moving the tips towards
        each other instead would push them sideways as well, as the joints do not yield alike in all directions.
        """
        measured = scene.drives.motor_rad + offset_rad
        torque = self._pinch.torques_nm(measured, self._options.squeeze_n)
        goal = measured + (torque + self._friction * np.sign(torque)) / self._stiffness
        pieces = max(1, round(self._options.squeeze_s * PHYSICS_HZ / _LOOK_STEPS))
        for i in range(pieces):
            command = command_rad + (goal - command_rad) * (i + 1) / pieces
            scene.drives.target_rad = command - offset_rad
            scene.run(_LOOK_STEPS)
        return goal

    def _grip(self, values: Values, angles_rad: FloatArray, objects: tuple[Placed, ...]) -> Grip:
        body = objects[0].body
        options, table = self._options, f"object.{body.kind}"
        elasticity, pinch = number(values, "skin.elasticity_pa_per_m"), self._pinch
        stiffness = pinch.surface.ball_stiffness(
            pinch.pose, body.radius_m, elasticity, options.stiffness_at_n
        )
        return Grip(
            angles_rad=angles_rad,
            drives=self._drives(values),
            objects=objects,
            finger_friction=number(values, "finger.lateral_friction"),
            lateral_friction=number(values, f"{table}.lateral_friction"),
            spinning_friction=number(values, f"{table}.spinning_friction"),
            rolling_friction=number(values, f"{table}.rolling_friction"),
            stiffness_n_per_m=stiffness,
            damping_ns_per_m=options.damping_ns_per_m,
        )

    def _drives(self, values: Values) -> DriveParameters:
        friction = np.zeros(self._pinch.joints)
        friction[self._first] = values["finger.stick_friction_12_nm"]
        friction[self._last] = values["finger.stick_friction_3_nm"]
        description = self._pinch.description
        return DriveParameters(
            stiffness_nm_per_rad=array(values, "finger.k_p_nm_per_rad"),
            damping_nms_per_rad=array(values, "finger.k_d_nms_per_rad"),
            low_pass_hz=description.gains.low_pass_hz,
            drive_stiffness_nm_per_rad=array(values, "finger.parasitic_stiffness_nm_per_rad"),
            friction_nm=friction,
            torque_limit_nm=description.limits.torque_nm,
            link_damping_nms_per_rad=self._options.link_damping_nms_per_rad,
        )
