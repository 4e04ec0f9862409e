"""The guarded hand in motion: options and control loop of a run, and the handover of an object from a person."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skincal.envs.pinch import Pinch
from skincal.envs.postures import Postures
from skincal.errors import WorkError
from skincal.hand.driver import HandState
from skincal.hand.guard import GuardedHand
from skincal.hand.loop import ControlLoop
from skincal.model.arrays import FloatArray, as_floats
from skincal.robot import HandDescription


@dataclass(frozen=True)
class DeployOptions:
    """Times, speeds and forces of a run. All defaults are assumptions; none is published.

    Attributes:
        low_pass_hz: corner frequency of the low-pass filter on commanded angles, at the hand's rate [Hz].
        approach_rad_per_s: joint speed of the motion to the open pinch [rad/s].
        open_m: distance of the open fingertips beyond the object's width [m].
        closing_m_per_s: speed at which the tips approach the object [m/s]. The drives lag in proportion to the speed,
            and this lag becomes a force at contact.
        contact_n: smallest normal force of a contact [N]; above the apparent force of friction in the drives.
        squeeze_n: initial normal force on the object [N].
        squeeze_s: time over which that force rises [s].
        settle_s: time at rest before the policy begins [s].
        rest_s: time over which the rest values of torques and taxels are averaged [s].
        lost_s: time without force on either finger after which the object counts as lost [s].
        late_s: delay of a policy step that ends the run: two and a half steps, less than the guard's limit for a lost
            hand [s].
    """

    low_pass_hz: float = 8.0
    approach_rad_per_s: float = 0.5
    open_m: float = 0.012
    closing_m_per_s: float = 0.006
    contact_n: float = 0.4
    squeeze_n: float = 1.5
    squeeze_s: float = 0.2
    settle_s: float = 0.3
    rest_s: float = 0.3
    lost_s: float = 0.3
    late_s: float = 0.25


Watch = Callable[[HandState, str], None]
"""Callback for every state, with the name of the present phase."""


class Motion(ControlLoop[GuardedHand, HandState]):
    """Control loop that stores all states.

    Attributes:
        doing: name of the present phase.
        places_m: position (2,) of the object at each state [m]; NaN if unknown.
        phases: phase of each state.
        rest_counts: (J,) rest levels of the taxels [counts].
    """

    def __init__(self, hand: GuardedHand, watch: Watch | None = None) -> None:
        super().__init__(hand, watch)
        self.doing = "waiting"
        self.places_m: list[FloatArray] = []
        self.phases: list[str] = []
        self.rest_counts: FloatArray = np.zeros(0)

    def _sample(self, state: HandState) -> HandState:
        self.places_m.append(self.rig.object_position_m())
        self.phases.append(self.doing)
        return state

    def go(self, goal_rad: FloatArray, speed_rad_per_s: float) -> None:
        """Move along a straight line in joint space to commanded angles (n,) [rad], with a largest speed [rad/s]."""
        start = self.now.q_desired_rad
        far = float(np.abs(goal_rad - start).max())
        count = max(1, int(np.ceil(far / (speed_rad_per_s * self.period_s))))
        for k in range(1, count + 1):
            self.step(start + (goal_rad - start) * k / count)


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
