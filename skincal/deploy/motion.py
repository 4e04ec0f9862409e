"""Options of a policy's run, and the guarded hand that is moved period by period, with everything stored."""

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
    """Times, speeds and forces of a run; all of them assumed, none published.

    Attributes:
        low_pass_hz: corner frequency of the filter on commanded angles, at the hand's rate [Hz].
        approach_rad_per_s: joint speed on the way to the open pinch [rad/s].
        open_m: the tips are so much further apart than the object is wide [m].
        closing_m_per_s: how fast the tips approach the object [m/s]. The drives lag behind in proportion to it, and by
            so much they press on what stops them.
        contact_n: a finger touches from this normal force on [N]; above what friction in the drives feigns.
        squeeze_n: normal force with which the object is held at first [N].
        squeeze_s: time over which that force comes up [s].
        settle_s: time at rest before the policy begins [s].
        rest_s: time over which torques and taxels at rest are taken [s].
        lost_s: the object counts as lost when neither finger has pressed on anything for so long [s].
        late_s: a step of the policy that begins so much too late ends the run: two steps and a half, less than what the
            guard takes for a hand that is lost [s].
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
"""Called with every state, and with what the hand is doing."""


class Motion(ControlLoop[HandState]):
    """Control loop that keeps all states.

    Attributes:
        places_m: where the object was at each of them; NaN where nobody knows.
        phases: what the hand was doing at each of them.
        rest_counts: taxels at rest (J,) [counts].
    """

    def __init__(self, hand: GuardedHand, watch: Watch | None = None) -> None:
        super().__init__(hand, watch)
        self.doing = "waiting"
        self.places_m: list[FloatArray] = []
        self.phases: list[str] = []
        self.rest_counts: FloatArray = np.zeros(0)

    def _sample(self, state: HandState) -> HandState:
        self.places_m.append(self.hand.object_position_m())
        self.phases.append(self.doing)
        return state

    def go(self, goal_rad: FloatArray, speed_rad_per_s: float) -> None:
        """Go straight to commanded angles (n,) [rad], no joint faster than a speed [rad/s]."""
        start = self.now.q_desired_rad
        far = float(np.abs(goal_rad - start).max())
        count = max(1, int(np.ceil(far / (speed_rad_per_s * self.period_s))))
        for k in range(1, count + 1):
            self.step(start + (goal_rad - start) * k / count)
