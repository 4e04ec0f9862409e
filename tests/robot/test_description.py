"""Limits of a hand's description that no finger has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.errors import InputError
from skincal.robot import HandDescription, bundled_hand, check_limits
from skincal.robot.description import ImpedanceGains


def with_limits(**changes: object) -> HandDescription:
    hand = bundled_hand()
    own = {
        name: changes.pop(name)
        for name in ("max_force_n", "gains", "compliance_rad_per_nm")
        if name in changes
    }
    return replace(hand, limits=replace(hand.limits, **changes), **own)  # type: ignore[arg-type]


def test_the_bundled_hand_is_within_them() -> None:
    check_limits(bundled_hand())


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"velocity_rad_per_s": np.radians([180.0, 180, 180, 180, 1800, 180])},
            "velocity_deg_per_s of forefinger_2: expected at most 720 deg/s; got 1800 deg/s",
        ),
        ({"torque_nm": np.full(6, 1e300)}, "torque_nm of thumb_1: expected at most 10 N m; got 1e+300 N m"),
        ({"torque_nm": np.full(6, np.nan)}, "expected at most 10 N m; got nan N m"),
        ({"upper_rad": np.full(6, 7.0)}, "expected at most 360 deg; got 401.07 deg"),
        (
            {"gains": ImpedanceGains(np.full(6, 1e308), np.full(6, 0.3), 20.0)},
            "stiffness_nm_per_rad of thumb_1: expected at most 1000 N m/rad; got 1e+308 N m/rad",
        ),
        (
            {"gains": ImpedanceGains(np.full(6, 5.0), np.full(6, 300.0), 20.0)},
            "damping_nms_per_rad of thumb_1: expected at most 100 N m s/rad",
        ),
        (
            {"compliance_rad_per_nm": np.full(6, 40.0)},
            "compliance_rad_per_nm of thumb_1: expected at most 1 rad/(N m); got 40 rad/(N m)",
        ),
        ({"max_force_n": 1000.0}, "max_force_n: expected at most 50 N; got 1000 N"),
    ],
)
def test_others_need_somebody_who_says_so(changes: dict[str, object], text: str) -> None:
    hand = with_limits(**changes)
    with pytest.raises(InputError, match="--beyond-limits") as caught:
        check_limits(hand)
    assert text in str(caught.value)
    check_limits(hand, beyond=True)
