"""Handover: a hand takes an object from a person, and releases it at the end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.deploy.motion import DeployOptions, Motion
from skincal.envs.grasp import Postures
from skincal.envs.pinch import Pinch
from skincal.errors import WorkError
from skincal.hand.driver import HandState
from skincal.model.arrays import FloatArray, as_floats
from skincal.robot import HandDescription

_TOUCHED = 3
"""Number of successive states with contact that confirm it: a single one may be noise."""


class PinchForces:
    """Estimator of both fingers' forces on an object between them, from joint angles and torques.

    Each finger has three joints: J^T f = tau is solved for the force f at the middle of the skin, and at the centre of
    the thumb's round end.

    Attributes:
        tare_nm: (n,) joint torques without an object, which are subtracted [N m].
    """

    def __init__(self, pinch: Pinch) -> None:
        self._out, self._foot, self._end = pinch.facing
        self._pinch, self._kinematics = pinch, pinch.kinematics
        self.tare_nm = np.zeros(pinch.joints)

    def vectors_n(self, state: HandState) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the forces (3,) [N] of the finger with the skin and of the thumb, and the skin's normal (3,).

        All are in the root frame.
        """
        torque, chains = state.tau_nm - self.tare_nm, self._kinematics
        skin, thumb = chains.frames(chains.link_angles(state.q_rad, torque))
        on_skin = chains.skin.jacobian(skin, skin.to_root(self._foot))[0]
        on_thumb = chains.indenter.jacobian(thumb, thumb.to_root(self._end))[0]
        by_skin = _force(on_skin, torque[chains.skin.columns])
        by_thumb = _force(on_thumb, torque[chains.indenter.columns])
        return by_skin, by_thumb, skin.rotations[0] @ self._out

    def normal_n(self, state: HandState) -> tuple[float, float]:
        """Return the normal forces of the finger with the skin and of the thumb [N], positive when they press."""
        skin, thumb, out = self.vectors_n(state)
        return float(skin @ out), float(-thumb @ out)

    def largest_n(self, state: HandState) -> float:
        """Return the larger magnitude of both forces, with their tangential components, for the guard [N]."""
        skin, thumb, _ = self.vectors_n(state)
        return float(max(np.linalg.norm(skin), np.linalg.norm(thumb)))

    def torques_nm(self, state: HandState, force_n: float) -> FloatArray:
        """Return joint torques (n,) [N m] that press both fingers on each other along the skin's normal."""
        q_rad = self._kinematics.link_angles(state.q_rad, state.tau_nm - self.tare_nm)
        return self._pinch.torques_nm(q_rad, force_n)


def _force(jacobian: FloatArray, torque_nm: FloatArray) -> FloatArray:
    """Return the force (3,) that torques (3,) exert [N]; for a stretched finger, the one of smallest magnitude."""
    square = jacobian @ jacobian.T
    return as_floats(np.linalg.solve(square + 1e-12 * np.eye(3), jacobian @ torque_nm))


@dataclass(frozen=True, eq=False)
class Handover:
    """Motions that take an object of a width from a person and release it.

    Attributes:
        motion: the hand.
        description: of the hand.
        postures: joint angles over the distance of the fingertips.
        forces: estimator of the fingers' forces.
        width_m: width of the object [m].
        options: speeds and forces.
    """

    motion: Motion
    description: HandDescription
    postures: Postures
    forces: PinchForces
    width_m: float
    options: DeployOptions

    def take(self) -> FloatArray:
        """Open the fingers, close them on an object until both touch it, and squeeze.

        Returns:
            (n,) commanded angles that hold the object [rad].

        Raises:
            WorkError: the fingers closed without touching an object.
        """
        motion = self.motion
        states = motion.hold(self._open("opening"), self.options.rest_s)
        self.forces.tare_nm = np.mean([state.tau_nm for state in states], axis=0)
        motion.rest_counts = np.mean([state.taxels for state in states], axis=0)
        motion.doing = "closing"
        command = self._close()
        motion.doing = "squeezing"
        return self._squeeze(command)

    def let_go(self) -> None:
        """Open the fingers again."""
        self._open("letting go")

    def _open(self, doing: str) -> FloatArray:
        """Open the fingers; return their commanded angles (n,) [rad]."""
        self.motion.doing = doing
        goal = self.postures.at(self.width_m + self.options.open_m)
        self.motion.go(goal, self.options.approach_rad_per_s)
        return goal

    def _close(self) -> FloatArray:
        """Close each finger until it touches; return the commanded angles (n,) at contact [rad].

        Each closes independently, as the object is not held exactly in the middle.
        """
        motion, options, width_m = self.motion, self.options, self.width_m
        thumb = np.isin(self.description.joints, self.description.indenter_finger.joints)
        widths = np.full(2, width_m + options.open_m)
        command, touched = self.postures.at(widths[0]), 0
        while touched < _TOUCHED:
            free = np.array(self.forces.normal_n(motion.now)) < options.contact_n
            widths -= free * options.closing_m_per_s * motion.period_s
            # Fingers without an object meet at a width of zero; joint errors can shift this by a few millimetres.
            if widths.mean() < width_m / 3:
                raise WorkError(
                    f"pinch: expected an object about {1e3 * width_m:.0f} mm wide between the fingertips; got none: "
                    "they closed, and not both of them pressed. Put it on the middle of the sensor before the fingers "
                    "close."
                )
            command = np.where(thumb, self.postures.at(widths[1]), self.postures.at(widths[0]))
            motion.step(command)
            touched = 0 if free.any() else touched + 1
        return command

    def _squeeze(self, command_rad: FloatArray) -> FloatArray:
        """Raise the normal force by angles (n,) that exceed the measured ones by torque over joint stiffness [rad]."""
        motion, options = self.motion, self.options
        # Average some states: noise in a single one would act as a torque that pushes the object aside.
        still = motion.hold(command_rad, options.squeeze_s)
        measured = np.mean([state.q_rad for state in still], axis=0)
        torque = self.forces.torques_nm(still[-1], options.squeeze_n) + self.forces.tare_nm
        goal = measured + torque / self.description.gains.stiffness_nm_per_rad
        count = motion.steps(options.squeeze_s)
        for k in range(1, count + 1):
            motion.step(command_rad + (goal - command_rad) * k / count)
        motion.hold(goal, options.settle_s)
        return goal
