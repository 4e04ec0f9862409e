"""Properties of every indenter; a kind added to model_shapes.indenters() gets all of these tests."""

from __future__ import annotations

import numpy as np
import pytest
from model_shapes import bolt_mesh, indenters, sphere_mesh

from skincal.model import FlatPunch, Indenter, MeshIndenter, Sphere

ALL = indenters()
UP = np.array([0.0, 0.0, 1.0])
every = pytest.mark.parametrize("indenter", ALL.values(), ids=ALL)


def _directions(count: int, lean: float, seed: int = 0) -> np.ndarray:
    directions = UP + lean * np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _origins(count: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.008, 0.008, (count, 3))


@every
def test_it_touches_the_origin_from_above(indenter: Indenter):
    assert indenter.cast(np.zeros((1, 3)), UP).distance_m[0] == pytest.approx(0.0, abs=1e-15)
    distance = indenter.cast(_origins(500) * [1, 1, 0], UP).distance_m
    assert distance.min() >= -1e-15
    assert np.isinf(distance).any()


@every
def test_normals_are_unit_and_nan_where_the_ray_misses(indenter: Indenter):
    directions = _directions(500, 0.8)
    hits = indenter.cast(_origins(500), directions)
    hit = np.isfinite(hits.distance_m)
    assert 50 < hit.sum() < 500
    np.testing.assert_allclose(np.linalg.norm(hits.normals[hit], axis=1), 1.0, rtol=1e-9)
    assert np.all(np.sum(hits.normals[hit] * directions[hit], axis=1) <= 1e-12)
    assert np.isnan(hits.normals[~hit]).all()
    assert np.all(hits.distance_m[~hit] == np.inf)


@every
def test_the_whole_line_counts(indenter: Indenter):
    origins, directions = _origins(300), _directions(300, 0.5)
    near = indenter.cast(origins, directions)
    far = indenter.cast(origins + 0.05 * directions, directions)
    hit = np.isfinite(near.distance_m)
    np.testing.assert_allclose(far.distance_m[hit], near.distance_m[hit] - 0.05, atol=1e-9)
    assert far.distance_m[hit].max() < 0


@every
def test_one_direction_stands_for_all_and_shapes_are_kept(indenter: Indenter):
    origins = _origins(60)
    one = indenter.cast(origins, UP)
    many = indenter.cast(origins.reshape(3, 20, 3), np.tile(UP, (3, 1, 1)))
    assert many.distance_m.shape == (3, 20)
    np.testing.assert_allclose(many.distance_m.ravel(), one.distance_m)
    np.testing.assert_allclose(many.normals.reshape(-1, 3), one.normals)


@every
def test_no_rays_no_hits(indenter: Indenter):
    hits = indenter.cast(np.zeros((0, 3)), UP)
    assert hits.distance_m.shape == (0,)
    assert hits.normals.shape == (0, 3)


def test_a_sphere_is_round():
    hits = Sphere(0.006).cast([[0.003, 0.0, -0.001]], UP)
    height = 0.006 - np.sqrt(0.006**2 - 0.003**2)
    assert hits.distance_m[0] == pytest.approx(0.001 + height)
    np.testing.assert_allclose(hits.normals[0], [0.5, 0.0, -np.sqrt(0.75)])


def test_a_flat_punch_ends_at_its_rim_and_a_ray_along_it_misses():
    punch = FlatPunch(0.003)
    np.testing.assert_array_equal(
        punch.cast([[0.0029, 0, -0.001], [0.0031, 0, -0.001]], UP).distance_m, [0.001, np.inf]
    )
    assert punch.cast([[0.0, 0, 0.0]], [1.0, 0.0, 0.0]).distance_m[0] == np.inf
    assert punch.cast([[0.0, 0, 0.001]], -UP).distance_m[0] == pytest.approx(0.001)


def test_a_mesh_of_a_ball_tends_to_the_ball():
    origins = _origins(2000) * [0.5, 0.5, 0.1]
    exact = Sphere(0.006).cast(origins, UP).distance_m
    error = [np.abs(sphere_mesh(level).cast(origins, UP).distance_m - exact).max() for level in (2, 3, 4, 5)]
    assert np.all(np.divide(error[:-1], error[1:]) > 3)  # about 4 a level
    assert error[-1] < 4e-6


def test_first_surface_of_a_shape_that_is_not_convex():
    # The head lies 1.3 mm (an edge: 2 mm) lower than the shaft, whose side is what a ray along x meets behind it.
    hits = bolt_mesh().cast([[0.012, 0.0, 0.0], [0.004, 0.0, 0.0]], UP)
    assert -2.1e-3 < hits.distance_m[0] < -1.3e-3
    assert hits.distance_m[1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("kind", [Sphere, FlatPunch])
@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_a_radius_is_a_positive_number(kind, radius):
    with pytest.raises(ValueError, match="radius_m: expected a finite number > 0"):
        kind(radius)


def test_a_mesh_keeps_its_vertices():
    assert isinstance(bolt_mesh(), MeshIndenter)
    assert bolt_mesh().vertices_m.flags.writeable is False
