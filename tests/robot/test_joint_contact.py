"""The contact that joint angles and torques tell of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hands import other_hand

from skincal.dataset.kinds import SURFACES
from skincal.errors import WorkError
from skincal.robot import Kinematics, bundled_hand, contact_from_joints, place_indenter, read_hand


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
