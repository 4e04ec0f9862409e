"""Options of the guard: limits and time-outs."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from skincal.errors import InputError, Problem


@dataclass(frozen=True)
class GuardOptions:
    """Limits in addition to those of the hand's description, and time-outs.

    Attributes:
        timeout_s: longest duration of a call to the driver, after which it is abandoned and the hand stopped [s].
        connect_timeout_s: the same for connecting and closing [s].
        stop_timeout_s: longest wait for ``stop`` [s].
        idle_s: time without a call after which the hand is stopped [s]; None: never.
        stale_s: time on our clock within which the hand's clock must advance [s].
        lag_s: largest difference between the clock of a real-time hand and ours; for a simulated hand
            the largest delay of a state [s]. None: not checked.
        taxel_age_s: largest age of a taxel value, on the hand's clock [s].
        taxel_ahead_s: largest lead of a taxel's time stamp, for clocks that do not quite agree [s].
        joint_margin_rad: largest excess of a measured angle over a joint limit (offsets, overshoot) [rad]; commands
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
        optional = ("idle_s", "lag_s", "max_force_n")
        zero = ("joint_margin_rad", "taxel_ahead_s")
        problems = [
            Problem(f"GuardOptions.{item.name}", "a finite number above zero", repr(value))
            for item in fields(self)
            if item.name != "beyond_limits"
            and not ((value := getattr(self, item.name)) is None and item.name in optional)
            and not (
                isinstance(value, int | float) and 0 <= value < math.inf and (value or item.name in zero)
            )
        ]
        if problems:
            raise InputError(problems)
