"""The hidden truth: what is drawn, from where, and what it does to the measured positions."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hands import other_hand
from sessions import exact, press, session

from skincal.errors import InputError
from skincal.robot import Kinematics, bundled_hand, read_hand
from skincal.sim import Truth, TruthOptions, position_error


def drawn(seed: int, **more: object) -> Truth:
    return Truth.draw(np.random.default_rng(seed), bundled_hand(), **more)  # type: ignore[arg-type]


def test_truths_lie_in_their_ranges() -> None:
    mount = bundled_hand().meta.mount
    for seed in range(50):
        truth = drawn(seed)
        assert mount.y_range_m[0] + 0.001 < truth.pose.y_m < mount.y_range_m[1] - 0.001
        assert mount.beta_range_deg is not None
        assert abs(np.degrees(truth.pose.beta_rad)) <= 6.0
        assert abs(np.degrees(truth.pose.alpha_rad)) <= 10.0
        assert 3.0e8 <= truth.elasticity_pa_per_m <= 7.0e8
        assert 61 <= truth.scale_per_n <= 76
        assert np.all(
            (truth.joints.drive_stiffness_nm_per_rad >= 15) & (truth.joints.drive_stiffness_nm_per_rad <= 35)
        )
        assert np.all((truth.joints.friction_nm >= 0.01) & (truth.joints.friction_nm <= 0.09))
        np.testing.assert_array_equal(truth.joints.friction_nm > 0.05, [False, False, True] * 2)


def test_a_seed_gives_the_same_truth() -> None:
    assert drawn(4).model_dict(plane=False) == drawn(4).model_dict(plane=False)
    assert drawn(4).model_dict(plane=False) != drawn(5).model_dict(plane=False)


def test_effects_change_nothing_else_that_is_drawn() -> None:
    plain, some = drawn(4), drawn(4, effects={"taxel_gain": 1.0})
    more = drawn(4, effects={"hysteresis": 0.5, "taxel_gain": 1.0})
    assert plain.model_dict(plane=False) == more.model_dict(plane=False)
    np.testing.assert_array_equal(plain.joints.offset_rad, more.joints.offset_rad)
    for key, value in some.effects["taxel_gain"].items():
        np.testing.assert_array_equal(value, more.effects["taxel_gain"][key])


def test_an_unknown_effect_is_refused() -> None:
    with pytest.raises(InputError, match="Did you mean hysteresis"):
        drawn(4, effects={"histeresis": 1.0})


def test_measured_positions_are_off_by_about_a_millimetre() -> None:
    kinematics = Kinematics(bundled_hand())
    errors = [position_error(kinematics, drawn(seed)) for seed in range(40)]
    rms = np.array([error.rms_m for error in errors])
    assert 0.3e-3 < np.median(rms) < 1.2e-3
    assert np.median([error.scatter_m for error in errors]) < 0.5 * np.median(rms)
    for error in errors:
        total = error.mean_across_m**2 + error.mean_along_m**2 + error.scatter_m**2
        assert error.rms_m**2 == pytest.approx(total, rel=1e-9)


@pytest.mark.parametrize("plane", [False, True])
def test_joints_without_errors_leave_positions_where_they_are(tmp_path: Path, plane: bool) -> None:
    other = read_hand(other_hand(tmp_path / "hand", plane=plane))
    for hand in (bundled_hand(), other):
        truth = exact(Truth.draw(np.random.default_rng(1), hand))
        assert position_error(Kinematics(hand), truth).rms_m < 1e-6


def test_a_joint_offset_moves_positions_by_its_lever() -> None:
    hand = bundled_hand()
    truth = exact(Truth.draw(np.random.default_rng(1), hand))
    # The thumb turns about an axis some 104 mm from the contact: so far beside it the contact seems to be.
    truth.joints.offset_rad[0] = 0.01
    error = position_error(Kinematics(hand), truth)
    assert abs(error.mean_along_m) < 1e-4
    assert 0.3e-3 < abs(error.mean_across_m) < 1.1e-3


def test_the_truth_is_plain_and_whole() -> None:
    with session(3) as hand:
        text = json.dumps(hand.truth_dict())
    truth = json.loads(text)
    assert set(truth["model"]) == {"y_m", "beta_deg", "alpha_deg", "elasticity_pa_per_m", "scale_per_n"}
    assert truth["effects"] == []
    assert len(truth["joints"]["offset_rad"]) == 6
    assert set(truth["position_error"]) == {"mean_across_m", "mean_along_m", "rms_m", "scatter_m"}


def test_session_truth_has_its_position_error_in_the_pose() -> None:
    with session(3) as hand:
        assert json.loads(json.dumps(hand.truth_dict()))["session"] == {"contacts": 0}
        press(hand)
        truth = json.loads(json.dumps(hand.truth_dict()))
    told = truth["session"]["truth_as_the_positions_tell_it"]
    error = truth["session"]["constant_position_error_m"]
    assert truth["session"]["contacts"] > 5
    assert told["y_m"] - truth["model"]["y_m"] == pytest.approx(error["along"])
    turned = math.radians(told["beta_deg"] - truth["model"]["beta_deg"]) * 0.0115
    assert turned == pytest.approx(error["across"])
    # One place and the mean over a grid of them are off alike.
    assert error["along"] == pytest.approx(truth["position_error"]["mean_along_m"], abs=0.5e-3)
    assert error["across"] == pytest.approx(truth["position_error"]["mean_across_m"], abs=0.5e-3)


def test_ranges_can_be_chosen() -> None:
    truth = drawn(3, options=TruthOptions(scale_per_n=(50.0, 50.0), joint_offset_rad=0.0))
    assert truth.scale_per_n == 50.0
    np.testing.assert_array_equal(truth.joints.offset_rad, 0.0)
