"""Kinematics against an independent implementation (PyBullet), and Jacobians against differences."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hands import other_hand

from skincal.errors import WorkError
from skincal.robot import HandDescription, Kinematics, bundled_hand, place_indenter, read_hand


@pytest.fixture(params=["bundled", "other", "plane"])
def hand(request: pytest.FixtureRequest, tmp_path: Path) -> HandDescription:
    if request.param == "bundled":
        return bundled_hand()
    return read_hand(other_hand(tmp_path / "hand", plane=request.param == "plane"))


@contextlib.contextmanager
def bullet(hand: HandDescription) -> Iterator[tuple[Any, int, dict[str, int], dict[str, int]]]:
    """A client of PyBullet with the hand: joints and links by name."""
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    body = pybullet.loadURDF(str(hand.urdf), useFixedBase=True, physicsClientId=client)
    info = [
        pybullet.getJointInfo(body, i, physicsClientId=client)
        for i in range(pybullet.getNumJoints(body, client))
    ]
    try:
        yield (
            pybullet,
            client,
            {row[1].decode(): row[0] for row in info},
            {row[12].decode(): row[0] for row in info},
        )
    finally:
        pybullet.disconnect(client)


def some_angles(hand: HandDescription, count: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    return rng.uniform(hand.limits.lower_rad, hand.limits.upper_rad, (count, len(hand.joints)))


def test_tips_are_where_pybullet_has_them(hand: HandDescription) -> None:
    kinematics = Kinematics(hand)
    angles = some_angles(hand, 7)
    skin, indenter = kinematics.skin_frames(angles), kinematics.indenter_frames(angles)
    with bullet(hand) as (engine, client, joints, links):
        for k, q in enumerate(angles):
            for name, angle in zip(hand.joints, q, strict=True):
                engine.resetJointState(0, joints[name], angle, physicsClientId=client)
            for finger, frames in ((hand.skin_finger, skin), (hand.indenter_finger, indenter)):
                state = engine.getLinkState(
                    0, links[finger.tip_link], computeForwardKinematics=1, physicsClientId=client
                )
                rotation = np.array(engine.getMatrixFromQuaternion(state[5])).reshape(3, 3)
                # PyBullet takes frames apart into quaternions of single precision.
                np.testing.assert_allclose(frames.origins_m[k], state[4], atol=1e-8)
                np.testing.assert_allclose(frames.rotations[k], rotation, atol=1e-6)


def test_jacobians_are_those_of_pybullet(hand: HandDescription) -> None:
    kinematics = Kinematics(hand)
    angles = some_angles(hand, 5)
    local = np.array([0.003, -0.002, 0.004])
    with bullet(hand) as (engine, client, joints, links):
        movable = sorted(joints[name] for name in hand.joints)
        order = [movable.index(joints[name]) for name in hand.joints]
        for finger, chain in (
            (hand.skin_finger, kinematics.skin),
            (hand.indenter_finger, kinematics.indenter),
        ):
            frames = chain.frames(angles)
            ours = chain.jacobian(frames, frames.to_root(np.tile(local, (len(angles), 1))))
            link = links[finger.tip_link]
            for k, q in enumerate(angles):
                sorted_q = np.empty(len(q))
                sorted_q[order] = q
                linear, _ = engine.calculateJacobian(
                    0,
                    link,
                    list(local),
                    list(sorted_q),
                    [0.0] * len(q),
                    [0.0] * len(q),
                    physicsClientId=client,
                )
                np.testing.assert_allclose(ours[k], np.array(linear)[:, order][:, chain.columns], atol=1e-9)


def test_jacobians_are_derivatives(hand: HandDescription) -> None:
    kinematics = Kinematics(hand)
    q = hand.home_rad[None]
    local = np.array([[0.003, -0.002, 0.004]])
    for chain in (kinematics.skin, kinematics.indenter):
        frames = chain.frames(q)
        jacobian = chain.jacobian(frames, frames.to_root(local))[0]
        for j, column in enumerate(chain.columns):
            step = np.zeros_like(q)
            step[0, column] = 1e-6
            moved = (chain.frames(q + step).to_root(local) - chain.frames(q - step).to_root(local)) / 2e-6
            np.testing.assert_allclose(jacobian[:, j], moved[0], atol=1e-9)


def centre_in_tip(kinematics: Kinematics, q_rad: np.ndarray) -> np.ndarray:
    """The sphere's centre in the fingertip frame (K, 3) [m]."""
    skin, indenter = kinematics.frames(q_rad)
    return skin.to_tip(indenter.origins_m)


def test_to_tip_undoes_to_root(hand: HandDescription) -> None:
    frames = Kinematics(hand).skin_frames(some_angles(hand, 4))
    points = np.random.default_rng(0).normal(size=(4, 3))
    np.testing.assert_allclose(frames.to_tip(frames.to_root(points)), points, atol=1e-12)


def test_one_posture_is_a_row_of_many(hand: HandDescription) -> None:
    kinematics = Kinematics(hand)
    angles = some_angles(hand, 3)
    np.testing.assert_array_equal(
        centre_in_tip(kinematics, angles[1])[0], centre_in_tip(kinematics, angles)[1]
    )


def test_both_at_once_are_each_alone(hand: HandDescription) -> None:
    kinematics = Kinematics(hand)
    angles = some_angles(hand, 4)
    alone = kinematics.skin_frames(angles), kinematics.indenter_frames(angles)
    for one, other in zip(kinematics.frames(angles), alone, strict=True):
        for name in ("rotations", "origins_m", "axes", "pivots_m"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-15)


def test_wrong_number_of_joints_is_refused() -> None:
    with pytest.raises(ValueError, match="6 joints"):
        centre_in_tip(Kinematics(bundled_hand()), np.zeros(5))


@pytest.mark.parametrize("beta_deg", [-40, -10, 0, 25, 40])
@pytest.mark.parametrize("y_m", [0.0125, 0.0235, 0.0345])
def test_the_indenter_reaches_the_whole_patch(beta_deg: float, y_m: float) -> None:
    hand = bundled_hand()
    kinematics = Kinematics(hand)
    beta = np.radians(beta_deg)
    target = np.array([0.0175 * np.sin(beta), y_m, 0.0175 * np.cos(beta)])
    q = place_indenter(kinematics, target, hand.home_rad)
    np.testing.assert_allclose(centre_in_tip(kinematics, q)[0], target, atol=1e-7)
    assert np.all((q >= hand.limits.lower_rad) & (q <= hand.limits.upper_rad))
    np.testing.assert_array_equal(q[kinematics.skin.columns], hand.home_rad[kinematics.skin.columns])


def test_inverse_kinematics_of_another_hand(tmp_path: Path) -> None:
    hand = read_hand(other_hand(tmp_path / "hand"))
    kinematics = Kinematics(hand)
    target = np.array([0.003, 0.02, 0.012])
    q = place_indenter(kinematics, target, hand.home_rad)
    np.testing.assert_allclose(centre_in_tip(kinematics, q)[0], target, atol=1e-7)


def test_a_point_out_of_reach_is_said_so() -> None:
    hand = bundled_hand()
    with pytest.raises(WorkError, match="misses by"):
        place_indenter(Kinematics(hand), [0.0, -0.3, 0.1], hand.home_rad)
