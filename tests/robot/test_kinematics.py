"""Kinematics against PyBullet, Jacobians against differences, and the contact that joints tell of."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hands import other_hand

from skincal.dataset.kinds import SURFACES
from skincal.errors import WorkError
from skincal.robot import (
    HandDescription,
    Kinematics,
    bundled_hand,
    contact_from_joints,
    place_indenter,
    read_hand,
)


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


def kinematics_of(which: str, folder: Path) -> Kinematics:
    hand = (
        bundled_hand()
        if which == "bundled"
        else read_hand(other_hand(folder / "hand", plane=which == "plane"))
    )
    return Kinematics(replace(hand, compliance_rad_per_nm=None))


def torques_for(kinematics: Kinematics, q: np.ndarray, point: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Torques that hold a force (3,) on the skin at a point (3,), both in the fingertip frame."""
    skin, indenter = kinematics.skin_frames(q), kinematics.indenter_frames(q)
    at, root_force = skin.to_root(point[None]), skin.rotations[0] @ force
    tau = np.zeros(len(q))
    tau[kinematics.indenter.columns] = kinematics.indenter.jacobian(indenter, at)[0].T @ root_force
    tau[kinematics.skin.columns] = -kinematics.skin.jacobian(skin, at)[0].T @ root_force
    return tau


@pytest.mark.parametrize("which", ["bundled", "other", "plane"])
def test_force_and_place_come_back(which: str, tmp_path: Path) -> None:
    kinematics = kinematics_of(which, tmp_path)
    meta = kinematics.description.meta
    beta, gap = (0.3, -0.0004)
    reach = meta.indenter.radius_m + gap
    if which == "plane":
        normal, point = np.array([0.0, 0.0, 1.0]), np.array([0.003, 0.018, 0.0])
    else:
        normal = np.array([np.sin(beta), 0.0, np.cos(beta)])
        point = meta.surface.radius_m * normal + [0.0, 0.018, 0.0]
    q = place_indenter(kinematics, point + reach * normal, kinematics.description.home_rad)
    across = np.array([normal[2], 0.0, -normal[0]])
    force = -3.0 * normal + 0.4 * across - 0.7 * np.array([0.0, 1.0, 0.0])
    contact = contact_from_joints(kinematics, q, torques_for(kinematics, q, point, force))
    np.testing.assert_allclose(contact.points_m[0], point, atol=2e-7)
    np.testing.assert_allclose(contact.normals[0], normal, atol=2e-5)
    np.testing.assert_allclose(contact.gap_m, gap, atol=2e-7)
    np.testing.assert_allclose(
        [contact.force_n[0], contact.shear_u_n[0], contact.shear_v_n[0]], [3.0, 0.4, -0.7], atol=1e-4
    )


def test_rows_are_independent_and_nan_stays_in_its_row() -> None:
    kinematics = Kinematics(bundled_hand())
    q = np.tile(kinematics.description.home_rad, (3, 1))
    tau = np.full((3, 6), 0.1)
    tau[1, 2] = np.nan
    q[2, 0] = np.nan
    contact = contact_from_joints(kinematics, q, tau)
    alone = contact_from_joints(kinematics, q[0], tau[0])
    np.testing.assert_allclose(contact.force_n[0], alone.force_n[0], rtol=1e-12)
    assert np.isnan(contact.force_n[1:]).all()
    assert np.isfinite(contact.gap_m[:2]).all()
    assert np.isnan(contact.gap_m[2])


@pytest.mark.parametrize("kind", [name for name, kind in SURFACES.items() if kind.on_hand])
def test_contacts_lie_on_every_surface_of_a_hand(kind: str) -> None:
    # The compiled routine has surfaces of its own: one that is allowed on a hand and missing there would be a plane.
    hand = bundled_hand()
    surface = replace(hand.meta.surface, kind=kind)
    kinematics = Kinematics(replace(hand, meta=replace(hand.meta, surface=surface)))
    q = np.random.default_rng(0).uniform(0.2, 0.4, (4, 6))
    found = contact_from_joints(kinematics, q, np.zeros((4, 6)))
    np.testing.assert_allclose(found.points_m, kinematics.surface.project(found.centres_m), atol=1e-12)
    np.testing.assert_allclose(found.normals, kinematics.surface.normal_at(found.centres_m), atol=1e-12)


def test_any_layout_of_the_arrays_is_taken() -> None:
    kinematics = Kinematics(bundled_hand())
    q = np.random.default_rng(0).uniform(0.2, 0.4, (4, 6))
    tau = np.full((4, 6), 0.1)
    q.flags.writeable = False
    usual = contact_from_joints(kinematics, q, tau)
    by_columns = contact_from_joints(kinematics, np.asfortranarray(q), tau[:, ::-1])
    np.testing.assert_array_equal(by_columns.force_n, usual.force_n)
    np.testing.assert_array_equal(by_columns.points_m, usual.points_m)


def test_the_give_of_the_drives_is_taken_off() -> None:
    hand = bundled_hand()
    tau = np.array([0.01, 0.2, -0.1, 0.05, -0.1, 0.2])
    soft = contact_from_joints(Kinematics(hand), hand.home_rad, tau)
    stiff = replace(hand, compliance_rad_per_nm=None)
    links = contact_from_joints(Kinematics(stiff), hand.home_rad - 0.04 * tau, tau)
    np.testing.assert_allclose(soft.points_m, links.points_m, atol=1e-12)
    uncorrected = contact_from_joints(Kinematics(stiff), hand.home_rad, tau)
    assert np.linalg.norm(uncorrected.centres_m - soft.centres_m) > 3e-4


def test_another_indenter_changes_the_gap_only() -> None:
    kinematics = Kinematics(bundled_hand())
    home = kinematics.description.home_rad
    usual = contact_from_joints(kinematics, home, np.zeros(6))
    other = contact_from_joints(kinematics, home, np.zeros(6), indenter_radius_m=0.004)
    np.testing.assert_allclose(other.gap_m - usual.gap_m, 0.002, atol=1e-12)
    np.testing.assert_array_equal(other.points_m, usual.points_m)


def test_nothing_touches_at_home(tmp_path: Path) -> None:
    for which in ("bundled", "other", "plane"):
        kinematics = kinematics_of(which, tmp_path / which)
        home = kinematics.description.home_rad
        contact = contact_from_joints(kinematics, home, np.zeros(len(home)))
        assert contact.gap_m[0] > 0.01
        assert contact.force_n[0] == 0.0


def test_a_force_that_no_torque_shows_is_refused(tmp_path: Path) -> None:
    path = other_hand(tmp_path / "hand")
    urdf = path.parent / "other.urdf"
    text = urdf.read_text().replace('xyz="1 0 0"', 'xyz="0 0 1"').replace('xyz="2 0 0"', 'xyz="0 0 1"')
    text = text.replace('rpy="0 0.1 0"', "")
    urdf.write_text(text.replace('rpy="1.5707963 0 3.1415927"', 'rpy="0 0 0"'))
    flat = Kinematics(read_hand(path))
    home = flat.description.home_rad
    with pytest.raises(WorkError, match="another pose"):
        contact_from_joints(flat, home, np.zeros(len(home)))
