"""A simulated skin keeps its history when a session is resumed in another process."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from sessions import contact, images, press, ramp, skin

from skincal.errors import InputError
from skincal.hand.sim import BREAK_S, SimDriver
from skincal.robot import Kinematics
from skincal.sim import SkinMemory
from skincal.sim.touch import Look, contact_stiffness


def test_a_skin_with_memory_resumes_without_a_break() -> None:
    strengths = {"hysteresis": 1.0, "creep": 1.0, "first_cycle": 2.0, "gain_drift": 1.0, "latency": 1.0}
    before, after = ramp(), ramp(3.2)
    whole = skin(**strengths)
    images(whole, before)
    expected = images(whole, after)
    going_on, new = skin(**strengths), skin(**strengths)
    going_on.remember(before)
    np.testing.assert_array_equal(images(going_on, after), expected)
    assert not np.array_equal(images(new, after), expected)


def test_the_file_is_read_up_to_a_truncated_row(tmp_path: Path) -> None:
    path = tmp_path / "skin.memory"
    looks = [Look(contact(0.04 * i, 0.5 * i), np.full(6, i), np.full(6, -i)) for i in range(4)]
    memory = SkinMemory(path, 6)
    assert memory.past == [] and memory.end_s == -np.inf
    for look in looks:
        memory.keep(look)
    memory.close()
    path.write_bytes(path.read_bytes()[:-5])
    for count in (3, 4):
        memory = SkinMemory(path, 6)
        assert len(memory.past) == count and memory.end_s == pytest.approx(0.04 * (count - 1))
        for got, expected in zip(memory.past, looks, strict=False):
            np.testing.assert_equal(vars(got.contact), vars(expected.contact))
            np.testing.assert_array_equal(got.tau_nm, expected.tau_nm)
        memory.keep(looks[3])
        memory.close()


def test_a_file_of_something_else_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "mine.txt"
    path.write_text("my own notes")
    with pytest.raises(InputError, match="simulated skin"):
        SkinMemory(path, 6)
    assert path.read_text() == "my own notes"


def test_a_hand_goes_on_after_what_it_remembers(tmp_path: Path) -> None:
    truth, memory = tmp_path / "truth.json", tmp_path / "skin.memory"
    ends: list[float] = []
    contacts: list[int] = []
    for _ in range(2):
        with SimDriver(seed=3, truth_path=truth, memory_path=memory) as driver:
            begin = driver.simulated.time_s
            press(driver.simulated)
            ends.append(driver.simulated.time_s)
        contacts.append(json.loads(truth.read_text())["session"]["contacts"])
    assert begin == pytest.approx(ends[0] + BREAK_S, abs=0.1)
    assert contacts[1] > 1.8 * contacts[0] > 0


def test_the_sphere_is_as_large_as_the_hand_says() -> None:
    for radius_m in (0.004, 0.008):
        with SimDriver(seed=3, indenter_radius_m=radius_m) as driver:
            hand = driver.simulated
            assert hand.description.meta.indenter.radius_m == radius_m
            assert driver.description.meta.indenter.radius_m == 0.006
            press(hand)
            touching = hand.contact()
            # Were another sphere in the physics, the gap would be millimetres off.
            stiffness = contact_stiffness(Kinematics(hand.description), driver.truth.elasticity_pa_per_m, 3.0)
            assert touching.force_n > 0.5
            assert touching.gap_m == pytest.approx(-touching.force_n / stiffness, rel=0.15)
    with pytest.raises(InputError, match="indenter_radius_m"):
        SimDriver(indenter_radius_m=0.0)
