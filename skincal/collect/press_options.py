"""Options of a press: speeds, thresholds and bounds of the press controller."""

from __future__ import annotations

from dataclasses import dataclass

from skincal.errors import check_options


@dataclass(frozen=True)
class CollectOptions:
    """Options of the press controller; times are on the hand's clock.

    Attributes:
        frame_rate_hz: largest rate of stored frames [Hz].
        clearance_m: height of the indenter above the skin while it travels [m].
        travel_m_per_s: largest speed of travel [m/s].
        travel_rad_per_s: largest speed of a joint during travel [rad/s].
        still_s: pause above the site, in which the torques at rest are measured [s].
        trim_per_s: rate at which the commanded angles are corrected until the measured ones are right, while nothing
            touches [1/s].
        approach_m_per_s: speed of the approach [m/s].
        touch_n_per_s: largest growth of the force when the skin is found; stiff fingers approach more slowly [N/s].
        search_m: depth below the skin's nominal surface at which the approach is given up [m].
        filter_s: time constant of the low-pass on the measured force [s].
        contact_n: force that counts as contact [N].
        contact_s: time for which the force must be above `contact_n` [s].
        near_m: height below which the approach is slow while the start of the skin is unknown [m].
        before_contact_m: the same, above the height at which earlier presses of a pose found the skin [m].
        regulate_share: proportional gain of the force error.
        regulate_per_s: integral gain of the force error [1/s].
        ease_s: time constant at the end of a force ramp [s].
        reach_s: longest time after the ramp for the force to come within the tolerance, before the hold begins [s].
        settle_s: first part of the hold, which is left out of a press's means [s].
        tolerance_n: a press whose mean force is off by more has missed its target, if it is also off by more than
            `tolerance_share` [N].
        tolerance_share: the same, relative to the target.
        slip_m: a contact point that moves more than this along the skin from the start of the hold has slipped [m].
        lost_share: contact is lost if the force in the hold falls below this part of the target.
        before_s: frames this long before the contact was detected belong to the loading [s].
        idle_s: pause after each press, at travelling height [s].
        rest_s: pause before the first press and after the last [s].
        reserve: largest torque of a press, relative to the joints' limits.
    """

    frame_rate_hz: float = 25.0
    clearance_m: float = 0.004
    travel_m_per_s: float = 0.1
    travel_rad_per_s: float = 1.5
    still_s: float = 0.1
    trim_per_s: float = 10.0
    approach_m_per_s: float = 0.006
    touch_n_per_s: float = 1.5
    search_m: float = 0.004
    filter_s: float = 0.015
    contact_n: float = 0.1
    contact_s: float = 0.02
    near_m: float = 0.002
    before_contact_m: float = 0.0008
    regulate_share: float = 1.0
    regulate_per_s: float = 15.0
    ease_s: float = 0.06
    reach_s: float = 0.4
    settle_s: float = 0.15
    tolerance_n: float = 0.05
    tolerance_share: float = 0.05
    slip_m: float = 0.001
    lost_share: float = 0.25
    before_s: float = 0.08
    idle_s: float = 0.16
    rest_s: float = 1.0
    reserve: float = 0.9

    def __post_init__(self) -> None:
        check_options(self, "a number above 0", lambda value: value > 0)
