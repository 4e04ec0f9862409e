"""Options of a policy's run, and the control loop that moves the guarded hand and stores all states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skincal.hand.driver import HandState
from skincal.hand.guard import GuardedHand
from skincal.hand.loop import ControlLoop
from skincal.model.arrays import FloatArray


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
