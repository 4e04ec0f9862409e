"""Options of the guard: limits and time-outs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from skincal.errors import check_options


@dataclass(frozen=True)
class GuardOptions:
    """Limits in addition to those of the hand's description, and time-outs.

    Attributes:
        timeout_s: a call to the driver that takes longer is left, and the hand stopped [s].
        connect_timeout_s: the same for connecting and for closing [s]; a simulated hand may take ten times as long
            to connect.
        stop_timeout_s: ``stop`` is waited for so long [s].
        idle_s: the hand is stopped when nobody calls for so long [s]; None: never.
        stale_s: the hand's clock must advance within this time, on our clock [s].
        lag_s: the clock of a hand that runs in real time may fall behind ours, or run ahead of it, by so much; that
            of a simulated one may be so late with a state [s]. None: not checked.
        taxel_age_s: a taxel value may be so old, on the hand's clock [s].
        taxel_ahead_s: a taxel's time stamp may lie so far in the future, for clocks that do not quite agree [s].
        joint_margin_rad: a measured angle may pass a joint limit by so much (offsets, overshoot) [rad]; commands
            may not.
        velocity_factor: largest measured velocity, relative to the limit of commanded ones.
        torque_factor: largest measured torque, relative to its limit.
        max_force_n: largest contact force [N]; None: that of the hand's description.
        beyond_limits: whether the limits of the hand's description may exceed those of any finger.
    """

    timeout_s: float = 1.0
    connect_timeout_s: float = 30.0
    stop_timeout_s: float = 0.5
    idle_s: float | None = 10.0
    stale_s: float = 0.5
    lag_s: float | None = 0.5
    taxel_age_s: float = 0.5
    taxel_ahead_s: float = 0.002
    joint_margin_rad: float = 0.05
    velocity_factor: float = 2.0
    torque_factor: float = 1.0
    max_force_n: float | None = None
    beyond_limits: bool = False

    def __post_init__(self) -> None:
        zero, optional = ("joint_margin_rad", "taxel_ahead_s"), ("idle_s", "lag_s", "max_force_n")
        absent = [name for name in optional if getattr(self, name) is None]
        finite = "a finite number above zero"
        check_options(self, finite, lambda x: _is_number(x) and x > 0, "beyond_limits", *zero, *absent)
        others = {*vars(self)} - {*zero}
        check_options(self, finite, _is_number, *others)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and 0 <= value < math.inf
