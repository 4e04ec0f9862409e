"""Presses on the patch against the paper's model read plainly, and every odd case."""

from __future__ import annotations

import numpy as np
import pytest
from model_shapes import POSE, cylinder_mesh, indenters, plain_cast, plain_loads, sphere_mesh, surface_of
from published import FINGER, LAYOUT, RADIUS_M, presses_on

from skincal.model import (
    Contacts,
    Converter,
    FlatPunch,
    Patch,
    Plane,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    Status,
    TaxelLayout,
)

E = 4e8
ALL = indenters()
PATCH = Patch.build(FINGER, LAYOUT, POSE)
SKIN = Skin(PATCH, SkinParameters(E, 68.0))
BALL = Sphere(0.006)
every = pytest.mark.parametrize("indenter", ALL.values(), ids=ALL)


def _scattered(count: int, seed: int = 0) -> Contacts:
    rng = np.random.default_rng(seed)
    across, along = rng.uniform(-9e-3, 9e-3, (2, count))
    return presses_on(FINGER, across, along, rng.uniform(0.2, 6.0, count))


@every
def test_the_points_left_out_change_nothing(indenter):
    contacts = _scattered(40)
    np.testing.assert_allclose(
        SKIN.loads(indenter, contacts), plain_loads(PATCH, indenter, contacts, E), atol=1e-12
    )


@pytest.mark.parametrize("count", [1, 2, 15, 40])
def test_a_patch_of_few_points(count):
    rng = np.random.default_rng(count)
    points, normals = FINGER.wrap(POSE, rng.uniform(-1e-3, 1e-3, (count, 2)))
    layout = TaxelLayout.grid(1, 1, taxel_size_m=1e-3, pitch_m=1e-3)
    patch = Patch(points, normals, np.full(count, 1e-7), np.zeros(count, dtype=int), layout)
    contacts = presses_on(FINGER, POSE.beta_rad * RADIUS_M, 0.0, [0.1, 3.0])
    skin = Skin(patch, SkinParameters(E, 1.0))
    np.testing.assert_allclose(skin.loads(BALL, contacts), plain_loads(patch, BALL, contacts, E), rtol=1e-9)


def test_the_papers_line_search_comes_within_its_step():
    contacts = _scattered(20)
    response = SKIN.respond(BALL, contacts)
    for k in range(20):
        weight = PATCH.areas_m2 * np.maximum(PATCH.normals @ contacts.normals[k], 0.0)
        local = (PATCH.points_m - contacts.points_m[k]) @ contacts.indenter_rotations[k]
        gap, _ = plain_cast(BALL, local, np.array([0.0, 0.0, 1.0]))
        gap = gap - gap[weight > 0].min()
        steps = np.arange(0, 3e-3, 1e-4)
        force = [E * np.sum(weight * np.maximum(step - gap, 0.0)) for step in steps]
        found = steps[np.argmax(np.array(force) >= contacts.force_n[k])]
        assert found - 1e-4 <= response.penetration_m[k] <= found


def test_load_has_two_projection_factors_and_force_one():
    # One point whose normal leans by a, touched by a punch that leans by b: F = E eps A cos a, load = F cos b.
    a, b = 0.3, 0.2
    layout = TaxelLayout.grid(1, 1, taxel_size_m=1e-3, pitch_m=1e-3)
    patch = Patch([[0.0, 0.0, 0.0]], [[np.sin(a), 0.0, np.cos(a)]], [1e-6], [0], layout)
    lean = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    contacts = Contacts([[0.0, 0, 0]], [[0.0, 0, 1]], [2.0], rotations=lean[None])
    response = Skin(patch, SkinParameters(E, 1.0)).respond(FlatPunch(0.01), contacts)
    assert response.force_n[0] == pytest.approx(2.0)
    assert response.penetration_m[0] == pytest.approx(2.0 / (E * 1e-6 * np.cos(a)))
    assert response.loads_n[0, 0] == pytest.approx(2.0 * np.cos(b))


def test_points_that_face_away_carry_and_feel_nothing():
    layout = TaxelLayout.grid(1, 2, taxel_size_m=1e-3, pitch_m=2e-3)
    normals = [[0.0, 0.0, 1.0], [0.6, 0.0, -0.8]]
    patch = Patch([[-1e-3, 0.0, 0.0], [1e-3, 0.0, 0.0]], normals, [1e-6, 1e-6], [0, 1], layout)
    response = Skin(patch, SkinParameters(E, 1.0)).respond(
        FlatPunch(0.01), Contacts([[0.0, 0, 0]], [[0.0, 0, 1]], [1.0])
    )
    np.testing.assert_allclose(response.loads_n, [[1.0, 0.0]])
    assert response.points[0] == 1


def test_gaps_and_margin_carry_force_that_no_taxel_feels():
    in_gap = presses_on(Plane(), 0.0, 0.0, 0.05)
    patch = Patch.build(Plane(), LAYOUT, SensorPose(0.0235, 0.0))
    response = Skin(patch, SkinParameters(E, 1.0)).respond(Sphere(0.002), in_gap)
    assert response.force_n[0] == pytest.approx(0.05)
    assert response.loads_n.sum() == 0.0


def test_the_centroid_and_the_number_of_points():
    response = SKIN.respond(BALL, presses_on(FINGER, 1e-3, 0.5e-3, 1.0))
    np.testing.assert_allclose(response.centroid_m, presses_on(FINGER, 1e-3, 0.5e-3, 1.0).points_m, atol=2e-4)
    assert 100 < response.points[0] < 300


# --- odd cases: each row of the table in one batch, so that none spoils another ---

ODD = [
    (2.0, 0.0, Status.OK, 2.0),
    (0.0, 0.0, Status.NO_FORCE, 0.0),
    (-1.0, 0.0, Status.NO_FORCE, 0.0),
    (np.nan, 0.0, Status.UNKNOWN, np.nan),
    (np.inf, 0.0, Status.UNKNOWN, np.nan),
    (-np.inf, 0.0, Status.UNKNOWN, np.nan),
    (2.0, np.nan, Status.UNKNOWN, np.nan),
    (0.0, np.nan, Status.UNKNOWN, np.nan),
    (2.0, 16e-3, Status.AT_BORDER, 2.0),
    (2.0, 19e-3, Status.AT_BORDER, 2.0),
    (2.0, 0.1, Status.NOT_TOUCHED, 0.0),
    (1e-30, 0.0, Status.OK, 1e-30),
]


def _odd_contacts() -> Contacts:
    force, along, _, _ = np.array(ODD, dtype=object).T
    points = np.stack([0 * along, 0.0235 + along, 0 * along + RADIUS_M], axis=1).astype(float)
    return Contacts(points, np.tile([0.0, 0.0, 1.0], (len(ODD), 1)), force.astype(float))


@pytest.mark.parametrize("indenter", [BALL, sphere_mesh(3)], ids=["sphere", "mesh"])
def test_odd_cases(indenter):
    skin = Skin(Patch.build(FINGER, LAYOUT, SensorPose(0.0235, 0.0)), SkinParameters(E, 68.0))
    response = skin.respond(indenter, _odd_contacts())
    for k, (_, _, status, force) in enumerate(ODD):
        assert Status(response.status[k]) is status, k
        assert response.force_n[k] == pytest.approx(force, nan_ok=True), k
        if status is Status.UNKNOWN:
            assert np.isnan(response.loads_n[k]).all()
            assert np.isnan(response.penetration_m[k])
        elif status in (Status.NO_FORCE, Status.NOT_TOUCHED):
            assert not response.loads_n[k].any()
            assert response.penetration_m[k] == 0.0
        if status not in (Status.OK, Status.AT_BORDER):
            assert response.points[k] == 0
            assert np.isnan(response.centroid_m[k]).all()
    # Off the taxels, though on the margin, no taxel answers; and the image follows the loads.
    assert not response.loads_n[8:11].any()
    image = skin.image(indenter, _odd_contacts())
    np.testing.assert_array_equal(np.isnan(image).all(axis=1), response.status == Status.UNKNOWN)
    assert image[0].max() == 7


def test_a_contact_that_pushes_the_other_way_touches_nothing():
    contacts = Contacts([[0.0, 0.0235, RADIUS_M]], [[0.0, 0.0, -1.0]], [2.0])
    assert SKIN.respond(BALL, contacts).status[0] == Status.NOT_TOUCHED


@pytest.mark.parametrize("indenter", [FlatPunch(0.2), FlatPunch(0.003)], ids=["chamber", "punch"])
def test_a_punch_larger_than_the_patch_presses_it_evenly(indenter):
    layout = TaxelLayout.grid(28, 10, taxel_size_m=5.692e-3, pitch_m=5.692e-3)
    patch = Patch.build(Plane(), layout, SensorPose(0.0235, 0.0), resolution_m=1e-3, margin_m=0.0)
    contacts = presses_on(Plane(), 0.0, 0.0, [50.0, 500.0])
    response = Skin(patch, SkinParameters(E, 1.0)).respond(indenter, contacts)
    np.testing.assert_allclose(response.loads_n.sum(axis=1), [50.0, 500.0])
    if indenter.radius_m > 0.1:
        np.testing.assert_allclose(response.loads_n, [[50 / 280] * 280, [500 / 280] * 280])
        assert np.all(response.status == Status.AT_BORDER)
    else:
        assert np.all(response.status == Status.OK)


def test_no_contacts_and_no_points():
    nothing = presses_on(FINGER, 0.0, 0.0, 1.0)[:0]
    assert SKIN.loads(BALL, nothing).shape == (0, 16)
    assert SKIN.respond(BALL, nothing).centroid_m.shape == (0, 3)
    empty = Patch(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=int), LAYOUT)
    response = Skin(empty, SkinParameters(E, 1.0)).respond(BALL, presses_on(FINGER, 0.0, 0.0, 1.0))
    assert response.status[0] == Status.NOT_TOUCHED
    assert not response.loads_n.any()


# --- meshes against closed forms ---


def test_a_mesh_of_the_ball_tends_to_the_ball():
    """Root mean square over all taxels of 60 presses, in parts of the force: a quarter with each level.

    From level 5 on the faces (0.22 mm) are smaller than the cells, and a cell meets a face at random: then a half,
    as the faces' normals lean by one step of the mesh either way.
    """
    contacts = _scattered(60)
    exact = SKIN.respond(BALL, contacts)
    error, depth = [], []
    for level in (2, 3, 4, 5):
        response = SKIN.respond(sphere_mesh(level), contacts)
        error.append(np.sqrt(np.mean(((response.loads_n - exact.loads_n) / contacts.force_n[:, None]) ** 2)))
        depth.append(np.abs(response.penetration_m - exact.penetration_m).max())
    assert error[0] < 1.5e-3
    assert np.all(np.divide(error[:2], error[1:3]) > 3)
    assert error[2] / error[3] > 1.5
    assert error[3] < 3e-5
    assert np.all(np.divide(depth[:-1], depth[1:]) > 3)
    assert depth[-1] < 1e-6


def test_a_mesh_of_the_finger_tends_to_the_finger():
    contacts = _scattered(40)
    exact = SKIN.loads(BALL, contacts)
    error = []
    for sections in (32, 64, 128):
        patch = Patch.build(surface_of(cylinder_mesh(sections)), LAYOUT, POSE)
        loads = Skin(patch, SkinParameters(E, 1.0)).loads(BALL, contacts)
        error.append(np.abs(loads - exact).max() / contacts.force_n.max())
    assert np.all(np.divide(error[:-1], error[1:]) > 2)
    assert error[-1] < 1e-3


# --- the skin's own part ---


def test_values_are_scaled_loads_and_images_are_converted():
    contacts = _scattered(12)
    scale = np.linspace(50, 80, 16)
    skin = Skin(PATCH, SkinParameters(E, scale), Converter(0, 40))
    np.testing.assert_allclose(skin.values(BALL, contacts), skin.loads(BALL, contacts) * scale)
    np.testing.assert_array_equal(
        skin.image(BALL, contacts), np.clip(np.rint(skin.values(BALL, contacts)), 0, 40)
    )
    assert skin.image(BALL, contacts).max() == 40


@pytest.mark.parametrize(
    ("elasticity", "scale", "message"),
    [
        (0.0, 1.0, "elasticity_pa_per_m: expected a finite number > 0"),
        (np.inf, 1.0, "elasticity_pa_per_m"),
        (E, np.nan, "scale_per_n: expected finite numbers"),
        (E, np.ones((2, 2)), "scale_per_n: expected shape"),
        (E, np.ones(3), "scale_per_n: expected one number or 16; got 3"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(elasticity, scale, message):
    with pytest.raises(ValueError, match=message):
        Skin(PATCH, SkinParameters(elasticity, scale))


# --- the converter ---


def test_rounds_and_clips_as_the_papers_sensor():
    np.testing.assert_array_equal(
        Converter().apply([-3.0, 0.4, 0.6, 1.5, 2.5, 254.7, 300.0]), [0, 0, 1, 2, 2, 255, 255]
    )


def test_an_absent_end_does_not_clip():
    np.testing.assert_array_equal(Converter(value_min=None).apply([-3.2, 300]), [-3, 255])
    np.testing.assert_array_equal(Converter(value_max=None).apply([-3.2, 300.2]), [0, 300])


def test_none_changes_nothing():
    values = np.array([[-1.25, np.nan, np.inf]])
    np.testing.assert_array_equal(Converter.none().apply(values), values)


def test_nan_stays_and_the_input_is_not_touched():
    values = np.array([0.4, np.nan])
    np.testing.assert_array_equal(Converter().apply(values), [0.0, np.nan])
    assert values[0] == 0.4


@pytest.mark.parametrize(("low", "high"), [(255, 0), (1, 1), (np.nan, 255)])
def test_a_range_that_is_none_is_refused(low, high):
    with pytest.raises(ValueError, match="value_min < value_max"):
        Converter(value_min=low, value_max=high)
