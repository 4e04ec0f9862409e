"""Laws of the effects that change what presses where and how hard."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from effect_sessions import BASE, FINGER, LAYOUT, SESSION, SKIN, contacts_at, rms, skin_with

from skincal.effects import Samples, Setting
from skincal.effects.cover import Cover
from skincal.effects.force_bias import ForceBias
from skincal.effects.parameter import Scene
from skincal.model import Contacts, FlatPunch, MeshIndenter, Sphere, contact_rotations

BALL = Sphere(0.006)


def presses(across_m: object, along_m: object, force_n: object, **covariates: object) -> Samples:
    return Samples.of(contacts_at(across_m, along_m, force_n), BALL, **covariates)


def test_force_bias_is_another_force():
    biased = skin_with("force_bias", offset_n=0.3, pose_scale=[1.0, 1.2])
    told = presses([0.0, 1e-3, 0.0], 0.0, [1.0, 1.0, 0.5], pose=[0, 1, -1])
    true = presses([0.0, 1e-3, 0.0], 0.0, [1.3, 1.5, 0.8])
    np.testing.assert_allclose(biased.values(told), BASE.values(true), rtol=1e-12)


def test_force_bias_leaves_rest_at_rest_and_never_pulls():
    told = presses(0.0, 0.0, [0.0, 0.1, 0.0], phase=[0, 2, 2])
    assert not skin_with("force_bias", offset_n=0.5).values(told)[0].any()
    assert skin_with("force_bias", offset_n=0.5).values(told)[2].any()
    assert not skin_with("force_bias", offset_n=-0.5).values(told).any()


def test_offset_and_scale_in_each_pose_are_one_case():
    scene = Scene(taxels=16, poses=2, top_counts=100.0, top_n=1.0, force_n=1.0, duration_s=60.0)
    for one in ForceBias().starts(scene):
        moved = [name for point in one.points for name in point if name != "onset_n"]
        assert sorted(moved) == ["offset_n", "pose_scale", "pose_scale"]
        assert len({float(point["onset_n"]) for point in one.points}) == 1


@pytest.mark.parametrize(("told_n", "true_n"), [(0.2, 0.35), (0.6, 0.825), (1.8, 2.07)])
def test_an_offset_of_friction_is_half_there_at_its_onset(told_n: float, true_n: float):
    biased = skin_with("force_bias", offset_n=0.3, onset_n=0.2)
    told, true = presses(0.0, 0.0, told_n), presses(0.0, 0.0, true_n)
    np.testing.assert_allclose(biased.values(told), BASE.values(true), rtol=1e-12)


def test_an_offset_with_an_onset_is_not_there_at_no_force():
    told = presses(0.0, 0.0, [0.0, 1e-6], phase=[2, 2])
    np.testing.assert_allclose(
        skin_with("force_bias", offset_n=0.5, onset_n=0.1).values(told), BASE.values(told), atol=1e-3
    )


def test_one_scale_stands_for_all_poses():
    told = presses(0.0, 0.0, [1.0, 1.0], pose=[0, 5])
    true = presses(0.0, 0.0, [1.1, 1.1])
    assert np.array_equal(skin_with("force_bias", pose_scale=1.1).values(told), BASE.values(true))


def test_contact_offset_is_another_place():
    moved = skin_with("contact_offset", pose_across_m=[0.0, 1e-3], pose_along_m=[-5e-4, 0.0])
    told = presses([1e-3, 1e-3], [0.0, 0.0], 2.0, pose=[0, 1])
    true = presses([1e-3, 2e-3], [-5e-4, 0.0], 2.0)
    np.testing.assert_allclose(moved.values(told), BASE.values(true), atol=1e-9)


def test_contact_offset_stretches_and_yields_with_force():
    centre = Setting(SKIN.patch, FINGER).centre_m
    at_centre = Samples.of(Contacts(centre[None], FINGER.normal_at(centre[None]), np.array([2.0])), BALL)
    stretched = skin_with("contact_offset", stretch_across=0.3, stretch_along=-0.2, skew=0.1)
    np.testing.assert_allclose(stretched.values(at_centre), BASE.values(at_centre), atol=1e-6)
    yields = skin_with("contact_offset", along_m_per_n=2e-4)
    true = presses(0.0, [2e-4, 6e-4], [1.0, 3.0])
    np.testing.assert_allclose(yields.values(presses(0.0, 0.0, [1.0, 3.0])), BASE.values(true), atol=1e-9)


def test_contact_offset_moves_a_free_object_without_turning():
    contacts = contacts_at([0.0], [0.0], [2.0])
    turned = contact_rotations(contacts.normals)
    free = replace(contacts, rotations=turned, origins_m=contacts.points_m + np.array([1e-3, 0.0, 1e-3]))
    samples = Samples.of(free, BALL, pose=0)
    skin = skin_with("contact_offset", pose_across_m=1e-3)
    felt = skin.contact(samples).samples.contacts
    step = felt.points_m - contacts.points_m
    assert np.linalg.norm(step) == pytest.approx(1e-3, rel=1e-3)
    np.testing.assert_allclose(felt.origins_m - free.origins_m, step, atol=1e-15)
    assert np.array_equal(felt.rotations, turned)


def test_measured_normals_turn_with_the_surface():
    contacts = contacts_at([0.0], [0.0], [2.0])
    tilted = contacts.normals + np.array([0.05, 0.02, 0.0])
    tilted /= np.linalg.norm(tilted)
    samples = Samples.of(replace(contacts, normals=tilted), BALL, pose=0)
    felt = skin_with("contact_offset", pose_across_m=1e-3).contact(samples).samples.contacts
    expected = tilted + FINGER.normal_at(felt.points_m) - contacts.normals
    np.testing.assert_allclose(felt.normals, expected / np.linalg.norm(expected), atol=1e-12)


@pytest.mark.parametrize("kind", [Sphere, FlatPunch])
def test_indenter_radius_is_another_indenter(kind: type):
    told, true = (
        Samples.of(contacts_at(1e-3, 0.0, [0.5, 3.0]), kind(radius)) for radius in (0.004, 0.004 * 1.5)
    )
    assert np.array_equal(skin_with("indenter_radius", scale=1.5).values(told), BASE.values(true))


@pytest.mark.parametrize(("said_m", "coated_m"), [(0.006, 0.0085), (0.004, 0.0065)])
def test_a_coat_adds_the_same_length_to_every_indenter(said_m: float, coated_m: float):
    told = Samples.of(contacts_at(0.0, 0.0, 2.0), Sphere(said_m))
    true = Samples.of(contacts_at(0.0, 0.0, 2.0), Sphere(coated_m))
    coated = skin_with("indenter_radius", scale=1.5, coat=1.0)
    np.testing.assert_allclose(coated.values(told), BASE.values(true), rtol=1e-12)


def test_no_indenter_has_less_than_a_tenth_of_its_radius():
    told = Samples.of(contacts_at(0.0, 0.0, 2.0), Sphere(0.002))
    true = Samples.of(contacts_at(0.0, 0.0, 2.0), Sphere(0.0002))
    worn = skin_with("indenter_radius", scale=0.3, coat=1.0)
    np.testing.assert_allclose(worn.values(told), BASE.values(true), rtol=1e-12)


def test_indenter_radius_of_a_mesh_is_a_mesh_of_another_size():
    balls = (
        trimesh.creation.icosphere(3, radius=radius).apply_translation([0, 0, radius])
        for radius in (0.006, 0.0066)
    )
    stated, true = (
        Samples.of(contacts_at(1e-3, 0.0, [0.5, 3.0]), MeshIndenter(ball.vertices, ball.faces))
        for ball in balls
    )
    np.testing.assert_allclose(
        skin_with("indenter_radius", scale=1.1).values(stated), BASE.values(true), rtol=1e-9
    )


def test_cover_carries_its_share_at_first_and_its_most_at_last():
    values = Cover().checked({"carried_n": 0.5, "share": 0.8}, 16)
    samples = presses(0.0, 0.0, [1e-6, 50.0, 0.0, -1.0])
    felt = Cover().apply(samples, values, Setting(SKIN.patch, FINGER)).contacts.force_n
    assert felt[0] == pytest.approx(0.2e-6, rel=1e-5)
    assert felt[1] == pytest.approx(49.5)
    assert felt[2] == 0.0
    assert felt[3] == -1.0


def test_cover_never_adds_force_and_keeps_its_order():
    force = np.linspace(0.0, 4.0, 50)
    samples = presses(0.0, 0.0, force)
    felt = skin_with("cover", carried_n=2.0, share=1.0).contact(samples).samples.contacts.force_n
    assert ((felt >= 0) & (felt <= force)).all()
    assert (np.diff(felt) > 0).all()


def test_shear_carries_the_contact_along():
    sheared = skin_with("shear", shift_m_per_n=5e-4)
    told = presses(0.0, 0.0, [2.0, 2.0], shear_u_n=[1.0, 0.0], shear_v_n=[0.0, -2.0])
    true = presses([5e-4, 0.0], [0.0, -1e-3], 2.0)
    np.testing.assert_allclose(sheared.values(told), BASE.values(true), atol=1e-9)


@pytest.mark.parametrize(("exponent", "at_8_n"), [(0.0, 1.0), (1 / 3, 0.5), (1.0, 0.125)])
def test_shear_carries_along_less_under_load(exponent: float, at_8_n: float):
    sheared = skin_with("shear", shift_m_per_n=5e-4, load_exponent=exponent)
    # By 5e-4 m for each newton at 1 N; below 0.1 N as far as at 0.1 N.
    at_least = 5e-4 * 0.1**-exponent
    told = presses(0.0, 0.0, [1.0, 8.0, 0.05], shear_u_n=[1.2, 1.2, 0.1], shear_v_n=0.0)
    true = presses([6e-4, 6e-4 * at_8_n, 0.1 * at_least], 0.0, [1.0, 8.0, 0.05])
    np.testing.assert_allclose(sheared.values(told), BASE.values(true), atol=1e-9)


def test_shear_carries_along_no_further_than_rubber_stretches():
    sheared = skin_with("shear", shift_m_per_n=1e-3, stiffening_per_n=1.0)
    told = presses(0.0, 0.0, [2.0] * 3, shear_u_n=[1.0, -0.6, 1e6], shear_v_n=[0.0, 0.8, 0.0])
    true = presses([5e-4, -3e-4, 1e-3], [0.0, 4e-4, 0.0], 2.0)
    np.testing.assert_allclose(sheared.values(told), BASE.values(true), rtol=1e-5, atol=1e-9)


def test_shear_adds_to_the_force_whatever_its_direction():
    sheared = skin_with("shear", force_share=0.2)
    told = presses(0.0, 0.0, [2.0] * 3, shear_u_n=[1.0, 0.0, -0.6], shear_v_n=[0.0, 1.0, 0.8])
    values = sheared.values(told)
    np.testing.assert_allclose(values, np.tile(BASE.values(presses(0.0, 0.0, 2.2)), (3, 1)), rtol=1e-9)
    assert not sheared.values(presses(0.0, 0.0, 0.0, shear_u_n=1.0, shear_v_n=0.0)).any()


def test_one_component_of_shear_is_no_shear():
    assert presses(0.0, 0.0, 1.0, shear_u_n=1.0).shear_n is None


def test_poses_are_drawn_about_no_bias():
    from skincal.effects import effect

    drawn = effect("contact_offset").at_strength(1.0, np.random.default_rng(2), LAYOUT, poses=4)
    offsets = drawn["pose_across_m"]
    assert offsets.shape == (4,)
    assert offsets.min() < 0 < offsets.max()


def test_effects_on_pose_and_force_come_before_the_contact():
    both = BASE.with_effects({"shear": {"force_share": 0.1}, "force_bias": {"offset_n": 0.2}})
    swapped = BASE.with_effects({"force_bias": {"offset_n": 0.2}, "shear": {"force_share": 0.1}})
    assert [a.effect.name for a in both.effects] == ["force_bias", "shear"]
    assert np.array_equal(both.values(SESSION), swapped.values(SESSION))
    assert rms(both.values(SESSION) - BASE.values(SESSION)) > 0
