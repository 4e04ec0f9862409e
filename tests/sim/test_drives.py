"""The drives alone: controller, friction, parasitic stiffness and low-pass."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skincal.sim import drives as drives_module
from skincal.sim.drives import DriveParameters, Drives


def drives(
    *, friction: float = 0.0, elastic: float = 25.0, low_pass_hz: float = 20.0, limit: float = 2.0
) -> Drives:
    parameters = DriveParameters(
        stiffness_nm_per_rad=np.array([5.0]),
        damping_nms_per_rad=np.array([0.3]),
        low_pass_hz=low_pass_hz,
        drive_stiffness_nm_per_rad=np.array([elastic]),
        friction_nm=np.array([friction]),
        torque_limit_nm=np.array([limit]),
        link_damping_nms_per_rad=0.01,
    )
    return Drives(parameters, [0.2], 1e-3)


def settle(drive: Drives, q: float, steps: int = 2000) -> float:
    for _ in range(steps):
        torque = drive.step([q], [0.0])[0]
    return torque


@pytest.mark.parametrize("elastic", [15.0, 35.0])
def test_a_held_link_meets_both_springs_in_series(elastic: float) -> None:
    drive = drives(elastic=elastic)
    drive.target_rad = [0.3]
    torque = settle(drive, 0.2)
    assert torque == pytest.approx(0.1 / (1 / 5.0 + 1 / elastic), rel=1e-9)
    # What the controller sees is the motor's angle: K_p (q_d - m) is the torque.
    assert 5.0 * (0.3 - drive.motor_rad[0]) == pytest.approx(torque, rel=1e-9)


def test_commanded_angles_are_low_passed() -> None:
    drive = drives(low_pass_hz=10.0)
    drive.target_rad = [1.2]
    for step in range(1, 60):
        drive.step([0.2], [0.0])
        expected = 1.2 - math.exp(-2 * math.pi * 10.0 * step * 1e-3)
        assert drive.filtered_rad[0] == pytest.approx(expected, rel=1e-9)


def test_friction_holds_small_and_reduces_large_torques() -> None:
    drive = drives(friction=0.08)
    drive.target_rad = [0.2 + 0.015]
    assert settle(drive, 0.2) == 0.0
    assert drive.motor_rad[0] == 0.2
    drive.target_rad = [0.2 + 0.1]
    # The motor stops where the controller's torque and the spring's differ by the friction.
    torque = settle(drive, 0.2)
    assert 5.0 * (0.3 - drive.motor_rad[0]) - torque == pytest.approx(0.08, rel=1e-9)


def test_friction_leaves_a_loop_between_loading_and_unloading() -> None:
    drive = drives(friction=0.08)
    drive.target_rad = [0.4]
    settle(drive, 0.2)
    drive.target_rad = [0.3]
    up = settle(drives_at(drive, 0.3), 0.2)
    assert up > settle(fresh(0.3), 0.2)


def drives_at(drive: Drives, target: float) -> Drives:
    drive.target_rad = [target]
    return drive


def fresh(target: float) -> Drives:
    return drives_at(drives(friction=0.08), target)


def test_the_controllers_torque_is_limited() -> None:
    drive = drives(limit=0.3)
    drive.target_rad = [1.2]
    assert settle(drive, 0.2) == pytest.approx(0.3, rel=1e-9)
    drive.target_rad = [-1.2]
    assert settle(drive, 0.2) == pytest.approx(-0.3, rel=1e-9)


def test_holding_lets_go() -> None:
    drive = drives()
    drive.target_rad = [0.3]
    before = settle(drive, 0.2)
    drive.hold()
    torques = [drive.step([0.2], [0.0])[0] for _ in range(2000)]
    assert max(torques) <= before + 1e-12
    # Both springs are at rest only where the link may follow; held, half of nothing is left but K_p's share.
    assert torques[-1] == pytest.approx(before / (1 + 25.0 / 5.0), rel=1e-6)


def test_a_hand_compiles_its_drives_when_it_connects() -> None:
    """A guard gives the first step little time; joints of another number are compiled anew."""
    five = np.full(5, 5.0)
    made = Drives(DriveParameters(five, five, 20.0, five, five, five, 0.01), five, 1e-3)
    compiled = len(drives_module._compiled().signatures)
    made.step(five.tolist(), five.tolist())
    assert len(drives_module._compiled().signatures) == compiled
