"""The simulated hand as a driver."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from calibrations import make_calibration
from hands import other_hand

from skincal.calibration import Effect, write_calibration
from skincal.effects import EFFECTS
from skincal.envs.reference_hand import ReferenceHand
from skincal.errors import InputError
from skincal.hand import HandCommand, HandDriver, HandError, create_driver
from skincal.hand.sim import SimDriver
from skincal.model.press import call
from skincal.robot import Kinematics, place_indenter


def states(driver: SimDriver, count: int = 30) -> np.ndarray:
    rows = []
    for i in range(count):
        state = driver.observe()
        driver.act(HandCommand(driver.description.home_rad + 0.002 * i))
        rows.append(np.concatenate([[state.time_s], state.q_rad, state.tau_nm, state.taxels]))
    return np.array(rows)


def test_the_same_seed_gives_the_same_states() -> None:
    with SimDriver(seed=3) as one, SimDriver(seed=3) as two, SimDriver(seed=4) as other:
        first = states(one)
        np.testing.assert_array_equal(first, states(two))
        assert not np.array_equal(first, states(other))


@pytest.mark.parametrize("make", [SimDriver, ReferenceHand])
def test_connecting_compiles_what_a_touch_needs(
    make: type[HandDriver], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(call, "_routine", None)
    with make():
        assert "press" in vars(call.routine())


def test_states_follow_each_other_by_the_period() -> None:
    with SimDriver(seed=3, rate_hz=50) as driver:
        assert driver.period_s == 0.02
        times = [driver.observe().time_s for _ in range(5)]
    np.testing.assert_allclose(np.diff(times), 0.02)


def test_a_stopped_hand_lets_go_and_hears_no_command() -> None:
    with SimDriver(seed=3) as driver:
        kinematics = Kinematics(driver.description)
        target = place_indenter(kinematics, [0.0, 0.0235, 0.0075], driver.description.home_rad)
        for i in range(100):
            driver.observe()
            driver.act(
                HandCommand(driver.description.home_rad + (target - driver.description.home_rad) * i / 100)
            )
        for _ in range(50):
            driver.observe()
        before = driver.simulated.contact().force_n
        assert before > 2
        driver.stop()
        forces = []
        for _ in range(50):
            driver.observe()
            driver.act(HandCommand(target))
            forces.append(driver.simulated.contact().force_n)
        assert max(forces) <= before * 1.01
        assert forces[-1] < 0.5 * before
        speeds = driver.observe().dq_rad_per_s
        assert np.abs(speeds).max() < 0.06
        driver.stop()


def test_after_connecting_again_commands_count_again() -> None:
    driver = SimDriver(seed=3)
    with driver:
        driver.observe()
        driver.stop()
    with driver:
        driver.observe()
        driver.act(HandCommand(driver.description.home_rad + 0.1))
        np.testing.assert_allclose(driver.observe().q_desired_rad, driver.description.home_rad + 0.1)


def test_a_hand_that_is_not_connected_says_so() -> None:
    driver = SimDriver(seed=3)
    with pytest.raises(HandError, match="connect"):
        driver.observe()
    driver.stop()
    driver.close()
    driver.close()


def test_the_truth_is_written(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    with SimDriver(seed=3, truth_path=path, effects={"creep": 0.5}) as driver:
        truth = json.loads(path.read_text())
        assert truth["seed"] == 3
        assert truth["model"]["scale_per_n"] == driver.truth.scale_per_n
        assert truth["effects"][0]["name"] == "creep"
        assert truth["effects"][0]["parameters"]["amplitude"] != 0


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_can_be_asked_for_by_its_name(name: str) -> None:
    driver = create_driver("sim", seed="3", effects=f"{name}=1")
    assert isinstance(driver, SimDriver)
    one = EFFECTS[name]
    assert not one.is_neutral(one.checked(driver.truth.effects[name], 16))
    none = create_driver("sim", seed="3", effects=f"{name}=0")
    assert isinstance(none, SimDriver)
    assert one.is_neutral(one.checked(none.truth.effects[name], 16))


def test_the_skin_may_be_that_of_a_calibration(tmp_path: Path) -> None:
    calibration = make_calibration(effects=(Effect("taxel_offset", {"offset_counts": 7.0}),))
    write_calibration(calibration, tmp_path / "cal")
    with create_driver("sim", seed=3, calibration=str(tmp_path / "cal")) as driver:
        assert isinstance(driver, SimDriver)
        assert driver.truth.pose == calibration.pose()
        assert driver.truth.effects["taxel_offset"]["offset_counts"] == 7.0
        assert driver.observe().taxels.min() >= 2.0


def test_effects_change_the_image_and_nothing_else() -> None:
    with SimDriver(seed=3) as plain, SimDriver(seed=3, effects={"taxel_offset": 3.0}) as other:
        one, two = states(plain), states(other)
        np.testing.assert_array_equal(one[:, :13], two[:, :13])
        assert not np.array_equal(one[:, 13:], two[:, 13:])


def test_another_hand(tmp_path: Path) -> None:
    path = other_hand(tmp_path / "hand")
    with SimDriver(seed=3, hand=str(path)) as driver:
        state = driver.observe()
        assert state.q_rad.shape == (7,)
        assert state.taxels.shape == (15,)


def test_it_is_registered_and_reads_its_options_from_text(tmp_path: Path) -> None:
    driver = create_driver("sim", seed="5", effects="creep=0.5,rate=1", rate_hz="50")
    assert isinstance(driver, SimDriver)
    assert driver.period_s == 0.02
    assert driver.truth.strengths == {"creep": 0.5, "rate": 1.0}


@pytest.mark.parametrize("rate_hz", [0, 30, 2000, -100])
def test_a_rate_that_does_not_fit_the_physics(rate_hz: int) -> None:
    with pytest.raises(InputError, match="divisor"):
        SimDriver(rate_hz=rate_hz)


def test_missing_physics_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"physics: expected the package pybullet; got none for Python 3\."):
        SimDriver()
