"""Options of a policy's run on a hand."""

from __future__ import annotations

from dataclasses import dataclass

SPEEDS_RAD_PER_S = {"marble": 0.3, "bolt": 0.6}
"""Joint velocity that an action of 1 commands, unless the policy says otherwise [rad/s]."""


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
