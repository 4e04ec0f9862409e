"""The simulated hand: laws that it has to obey."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hands import other_hand
from sessions import move, press, pressed, session

import skincal.robot
import skincal.sim
from skincal.errors import InputError, WorkError
from skincal.robot import Kinematics, bundled_hand, contact_from_joints, read_hand
from skincal.sim import SimOptions, SimulatedHand, TrueContact
from skincal.sim.physics_client import summed_force
from skincal.sim.touch import contact_stiffness


def readings(hand: SimulatedHand) -> np.ndarray:
    rows = []
    for depth in (-0.002, 0.004, 0.01, 0.006):
        move(hand, pressed(hand.description, depth), 0.15)
        reading = hand.reading()
        rows.append(np.concatenate([reading.q_rad, reading.tau_nm, reading.dq_rad_per_s, reading.taxels]))
    return np.array(rows)


def test_a_seed_gives_the_same_session_bit_for_bit() -> None:
    with session(5) as one, session(5) as two, session(6) as other:
        first = readings(one)
        np.testing.assert_array_equal(first, readings(two))
        assert not np.array_equal(first, readings(other))


def test_two_hands_in_one_process_do_not_disturb_each_other() -> None:
    with session(5) as alone:
        expected = readings(alone)
    with session(5) as one, session(9) as other:
        rows = []
        for depth in (-0.002, 0.004, 0.01, 0.006):
            move(other, pressed(other.description, depth / 2), 0.05)
            move(one, pressed(one.description, depth), 0.15)
            other.advance(30)
            reading = one.reading()
            rows.append(np.concatenate([reading.q_rad, reading.tau_nm, reading.dq_rad_per_s, reading.taxels]))
            if depth == 0.01:
                other.close()
                break
        np.testing.assert_array_equal(np.array(rows), expected[:3])


def test_the_joints_hold_what_the_contact_exerts() -> None:
    # PyBullet lets friction act on the two surfaces, which lie in one another: a couple that no force makes.
    for friction, share in ((0.0, 1e-3), (0.8, 0.02)):
        check_force(friction, share)


def check_force(friction: float, share: float) -> None:
    with session(2, perfect=True, options=SimOptions(friction=friction)) as hand:
        press(hand)
        true = hand.contact()
        reading = hand.reading()
        found = contact_from_joints(Kinematics(hand.description), reading.q_rad, reading.tau_nm)
        assert true.force_n > 1.0
        assert (abs(true.shear_v_n) > 0.5) == (friction > 0)
        for ours, truly in (
            (found.force_n[0], true.force_n),
            (found.shear_u_n[0], true.shear_u_n),
            (found.shear_v_n[0], true.shear_v_n),
        ):
            assert ours == pytest.approx(truly, abs=share * true.force_n)
        np.testing.assert_allclose(found.points_m[0], true.point_m, atol=1e-6)
        assert found.gap_m[0] == pytest.approx(true.gap_m, abs=1e-6)


def test_the_contact_is_a_spring_of_the_skins_stiffness() -> None:
    with session(2, perfect=True) as hand:
        stiffness = contact_stiffness(Kinematics(hand.description), hand.truth.elasticity_pa_per_m, 3.0)
        for depth in (0.005, 0.015):
            press(hand, depth)
            true = hand.contact()
            assert true.force_n / -true.gap_m == pytest.approx(stiffness, rel=0.02)


def test_the_contacts_stiffness_is_that_of_the_skin_model() -> None:
    """At the force that it is taken at, the skin model goes in as deep as the spring."""
    with session(2, perfect=True) as hand:
        skin = hand._skin._skin
        at = TrueContact(0.0, np.array([0, 0.0235, 0.0115]), np.array([0, 0, 1.0]), 3.0, 0, 0, 0, np.zeros(6))
        depth = skin.respond(hand._skin._indenter, at.contacts()).penetration_m[0]
        stiffness = contact_stiffness(Kinematics(hand.description), hand.truth.elasticity_pa_per_m, 3.0)
        assert 3.0 / depth == pytest.approx(stiffness, rel=0.1)


def test_without_contact_the_links_follow_the_command() -> None:
    with session(2, perfect=True) as hand:
        goal = hand.description.home_rad + np.array([0.1, -0.1, 0.1, -0.05, 0.05, 0.1])
        move(hand, goal, 0.3)
        hand.advance(800)
        np.testing.assert_allclose(hand.reading().q_rad, goal, atol=1e-5)
        assert np.abs(hand.reading().tau_nm).max() < 1e-4


def test_stick_friction_leaves_an_error_of_its_size() -> None:
    with session(2) as hand:
        goal = hand.description.home_rad + 0.05
        move(hand, goal, 0.3)
        hand.advance(800)
        joints = hand.truth.joints
        error = np.abs(goal - hand.reading().q_rad)
        bound = joints.friction_nm / 5.0 + 5 * joints.noise_rad
        assert np.all(error <= bound)
        assert error[2] > 0.3 * bound[2]


def test_holding_lets_go_of_what_is_exerted() -> None:
    with session(2) as hand:
        press(hand, 0.015)
        before = hand.contact().force_n
        hand.hold()
        forces = []
        for _ in range(100):
            hand.advance(10)
            forces.append(hand.contact().force_n)
        assert max(forces) < before * 1.01
        assert forces[-1] < 0.5 * before
        assert abs(forces[-1] - forces[-10]) < 0.01


def test_images_come_at_their_rate_with_a_time_for_each_taxel() -> None:
    with session(2) as hand:
        times = []
        for _ in range(20):
            hand.advance(10)
            reading = hand.reading()
            assert reading.taxel_time_s.shape == (16,)
            assert np.all(np.diff(reading.taxel_time_s) > 0)
            assert np.all(reading.taxel_time_s <= reading.time_s + 1e-12)
            times.append(reading.taxel_time_s[-1])
        assert np.unique(np.round(np.diff(np.unique(times)), 9)).tolist() == [0.04]


def test_the_image_shows_the_contact() -> None:
    with session(2) as hand:
        assert hand.reading().taxels.max() <= 5
        press(hand, 0.015)
        assert hand.reading().taxels.max() > 30
        image = hand._skin.base_values(hand.image_contact)
        assert np.abs(image - hand.reading().taxels).max() < 6
        hand.advance(40)  # to the next image
        assert image.sum() == pytest.approx(hand._skin.base_values(hand.image_contact).sum(), rel=0.05)


def test_counts_are_whole_and_within_the_converters_range() -> None:
    with session(2) as hand:
        press(hand, 0.02)
        taxels = hand.reading().taxels
        np.testing.assert_array_equal(taxels, np.rint(taxels))
        assert taxels.min() >= 0
        assert taxels.max() <= 255
        assert not np.signbit(taxels).any()


@pytest.mark.parametrize("plane", [False, True])
def test_another_hand(tmp_path: Path, plane: bool) -> None:
    """Seven joints in another order, other links and sensor, angles measured on the links."""
    description = read_hand(other_hand(tmp_path / "hand", plane=plane))
    y_m = 0.015
    with session(3, description=description, perfect=True) as hand:
        move(hand, pressed(description, -0.002, y_m), 0.8)
        move(hand, pressed(description, 0.003, y_m), 0.6)
        hand.advance(500)
        true, reading = hand.contact(), hand.reading()
        assert reading.taxels.shape == (15,)
        found = contact_from_joints(Kinematics(description), reading.q_rad, reading.tau_nm)
        assert true.force_n > 0.3
        assert found.force_n[0] == pytest.approx(true.force_n, rel=0.05)
        assert found.gap_m[0] == pytest.approx(true.gap_m, abs=1e-6)
        np.testing.assert_allclose(found.points_m[0], true.point_m, atol=1e-6)


def test_a_command_that_is_none_is_refused() -> None:
    with session(2) as hand:
        with pytest.raises(WorkError, match="6 finite angles"):
            hand.command(np.zeros(5))
        with pytest.raises(WorkError, match="6 finite angles"):
            hand.command(np.full(6, np.nan))


def test_options_are_checked() -> None:
    with pytest.raises(InputError, match="divisor"):
        SimOptions(taxel_hz=30)
    with pytest.raises(InputError, match="friction"):
        SimOptions(friction=float("nan"))


def test_a_urdf_that_pybullet_cannot_load(tmp_path: Path) -> None:
    from dataclasses import replace

    empty = tmp_path / "empty.urdf"
    empty.write_text("<robot/>")
    with pytest.raises(WorkError, match="PyBullet can load"):
        from skincal.sim.physics_client import Fingers

        Fingers(replace(bundled_hand(), urdf=empty), SimOptions(), 1e4)


def test_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    with session(2) as hand:
        hand.advance(10)
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err == ""


def point(link: int, force: float, normal: object = (0, 0, 1), sideways: float = 0.0) -> tuple[object, ...]:
    return (0, 1, 1, link, 7, None, None, normal, -1e-4, force, sideways, (1, 0, 0), 0.0, (0, 1, 0))


def test_forces_are_summed_over_the_contact_points() -> None:
    total = summed_force([point(4, 2.0, sideways=0.5), point(4, 1.0)], 4, 1e3)
    np.testing.assert_allclose(total, [0.5, 0, 3.0])
    np.testing.assert_allclose(summed_force([point(7, 2.0, sideways=0.5)], 4, 1e3), [-0.5, 0, -2.0])


@pytest.mark.parametrize("force", [float("nan"), float("inf"), -1.0, 1e9])
def test_a_force_that_cannot_be_is_left_out(force: float) -> None:
    np.testing.assert_array_equal(summed_force([point(4, force), point(4, 1.0)], 4, 1e3), [0, 0, 1.0])


def test_a_normal_or_friction_that_cannot_be_is_left_out() -> None:
    nan = float("nan")
    np.testing.assert_array_equal(summed_force([point(4, 1.0, (nan, 0, 1))], 4, 1e3), [0, 0, 0])
    np.testing.assert_array_equal(summed_force([point(4, 1.0, sideways=nan)], 4, 1e3), [0, 0, 1])


ROBOT = """
DEFAULT_HAND FORMAT Chain FingerDescription HandDescription HandState ImpedanceGains JointContact
JointLimits Kinematics TipFrames bundled_hand check_limits contact_from_joints place_indenter
read_hand hand_named joint_contact_force urdf_with_sphere
"""
SIM = """
JointTruth PositionError ReferenceSkin SimOptions SimulatedHand SkinMemory TrueContact Truth
TruthOptions position_error
"""


def test_public_names() -> None:
    for module, names in ((skincal.robot, ROBOT), (skincal.sim, SIM)):
        assert set(module.__all__) == set(names.split())
        assert all(getattr(module, name) is not None for name in names.split())
