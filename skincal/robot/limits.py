"""Plausibility bounds on the limits of a hand: a typing error in ``hand.toml`` must not lift a limit."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from skincal.errors import InputError, Problem
from skincal.robot.description import HandDescription

MOST_TURN_DEG = 360.0
MOST_VELOCITY_DEG_PER_S = 720.0
MOST_TORQUE_NM = 10.0
MOST_FORCE_N = 50.0
"""Largest limits that are accepted by default. Twice the speed of the DLR-Hand II (360 deg/s; its torque is
1.8 N m, the force of its fingertips 30 N), and more than any finger of this size gives or any skin bears."""

MOST_STIFFNESS_NM_PER_RAD = 1000.0
MOST_DAMPING_NMS_PER_RAD = 100.0
MOST_COMPLIANCE_RAD_PER_NM = 1.0
"""Largest gains, each more than twenty times that of the DLR-Hand II (5 N m/rad, 0.3 N m s/rad, 0.04 rad/(N m)); they
decide where the simulation, the contact force and a hand-over take the fingers to be."""

FIX = "Correct it; if the hand really bears that, allow it with --beyond-limits."


def check_limits(description: HandDescription, *, beyond: bool = False) -> None:
    """Refuse limits and gains that no finger has.

    Args:
        description: the hand.
        beyond: whether the user allows any limit.

    Raises:
        InputError: some limits or gains are above their bounds; all are reported.
    """
    limits, gains, give = description.limits, description.gains, description.compliance_rad_per_nm
    give = np.zeros(1) if give is None else give
    turn = np.maximum(np.abs(limits.lower_rad), np.abs(limits.upper_rad))
    rows = (
        ("lower_deg, upper_deg", np.degrees(turn), MOST_TURN_DEG, "deg"),
        ("velocity_deg_per_s", np.degrees(limits.velocity_rad_per_s), MOST_VELOCITY_DEG_PER_S, "deg/s"),
        ("torque_nm", limits.torque_nm, MOST_TORQUE_NM, "N m"),
        ("stiffness_nm_per_rad", gains.stiffness_nm_per_rad, MOST_STIFFNESS_NM_PER_RAD, "N m/rad"),
        ("damping_nms_per_rad", gains.damping_nms_per_rad, MOST_DAMPING_NMS_PER_RAD, "N m s/rad"),
        ("compliance_rad_per_nm", give, MOST_COMPLIANCE_RAD_PER_NM, "rad/(N m)"),
        ("max_force_n", np.array([description.max_force_n]), MOST_FORCE_N, "N"),
    )
    problems = [_problem(description, *row) for row in rows if not beyond and _exceeds(row[1], row[2])]
    if problems:
        raise InputError(problems)


def _exceeds(values: NDArray[np.float64], bound: float) -> bool:
    # Allow for rounding of degrees; a NaN sets no limit at all.
    return not bool((values <= bound * (1 + 1e-9)).all())


def _problem(
    description: HandDescription, name: str, values: NDArray[np.float64], bound: float, unit: str
) -> Problem:
    worst = int(np.argmax(np.where(np.isnan(values), math.inf, values)))
    joint = "" if name == "max_force_n" else f" of {description.joints[worst]}"
    return Problem(
        f'limits of the hand "{description.name}", {name}{joint}',
        f"at most {bound:g} {unit}",
        f"{values[worst]:.6g} {unit}",
        FIX,
    )
