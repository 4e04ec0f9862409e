"""``skincal eval`` on reference hands, in the other engine, and from a calibration."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import run

from skincal.deploy.trials import reference_runs
from skincal.train import Task, policy_path, read_policy
from skincal.train.evaluate import Trial
from skincal.train.scores import Runs, fare

POLICY = "marble-tactile-1"


def runs(errors_m: np.ndarray, dropped: int = 0) -> Runs:
    """Runs of 8 s whose errors stay as they are."""
    n, t = len(errors_m), 80
    error = np.repeat(errors_m[:, None], t, axis=1)
    return replace(Runs.empty(n, t, 10.0), error_m=error, dropped=np.arange(n) < dropped)


def test_reference_hands_are_each_another_and_the_same_again() -> None:
    policy = read_policy(policy_path(POLICY))
    trial = Trial(Task.marble, episodes=2, seed=4, duration_s=0.5)
    found, again = reference_runs(policy, trial), reference_runs(policy, replace(trial, episodes=1))
    assert found.error_m.shape == (2, 5) and not found.dropped.any()
    np.testing.assert_array_equal(found.error_m[:1], again.error_m)
    assert np.abs(found.error_m[0] - found.error_m[1]).max() > 1e-5
    # Places and errors are of the same moments.
    apart = np.linalg.norm(found.object_m - found.target_m, axis=2)
    np.testing.assert_allclose(apart, found.error_m, atol=1e-9)


def test_the_interval_holds_the_next_hand_as_often_as_it_says() -> None:
    rng, inside = np.random.default_rng(1), []
    for _ in range(400):
        errors = rng.lognormal(0.0, 0.5, 21)
        one = fare(runs(1e-3 * errors[:20]))
        inside.append(one.error_interval_m[0] <= 1e-3 * errors[20] <= one.error_interval_m[1])
    assert one.level == pytest.approx(19 / 21)
    assert np.mean(inside) == pytest.approx(19 / 21, abs=0.045)


def test_many_hands_give_95_percent_and_drops_count_in_success() -> None:
    one = fare(runs(np.linspace(1e-3, 2e-3, 199), dropped=20))
    assert one.level == pytest.approx(0.95) and one.success == pytest.approx(179 / 199)
    assert one.success_interval[0] < 179 / 199 < one.success_interval[1]
    assert one.error_interval_m == pytest.approx((1.02e-3, 1.98e-3), abs=1e-5)


def test_hands_that_all_drop_it_at_once_have_no_error() -> None:
    one = fare(runs(np.full(3, np.nan), dropped=3))
    assert one.success == 0.0 and np.isnan(one.error_m) and one.level == 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("bolt", "bolt-tactile-1", "--on", "reference"), "expected the task marble"),
        (("marble", POLICY, "--on", "reference", "--set", "skin.y_m=0.02"), "expected nothing, with --on reference"),
        (("marble", POLICY, "--on", "reference", "--trajectory", "random"), "expected circle"),
        (("marble", POLICY, "--calibration", "cal", "--randomize", "none"), "expected neither --ranges nor"),
        (("marble", POLICY, "--calibration", "nowhere"), "nowhere"),
        (("marble", POLICY, "--on", "mujoco", "--gif", "--out", "x"), "expected --on pybullet"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("eval", *arguments) == 2
    assert message in capsys.readouterr().err


def test_a_calibration_predicts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from calibrations import make_calibration

    from skincal.calibration import write_calibration

    cal = tmp_path / "cal"
    write_calibration(make_calibration(), cal)
    assert (
        run("eval", "marble", POLICY, "--calibration", cal, "--episodes", 2, "--duration-s", 3, "--json") == 0
    )
    told = json.loads(capsys.readouterr().out)
    prediction = told["policies"][0]["prediction"]
    assert told["on"] == "pybullet" and prediction["hands"] == 2 and 0 <= prediction["success"] <= 1
    assert prediction["level"] == pytest.approx(1 / 3)


def test_the_other_engine(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mujoco", reason="needs skincal[mujoco]")
    assert run("eval", "marble", POLICY, "--on", "mujoco", "--episodes", 2, "--json") == 0
    one = json.loads(capsys.readouterr().out)["policies"][0]
    assert one["drops"] == 0 and one["error_settled_m"] < 1e-3
