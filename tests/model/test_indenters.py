"""Properties of every indenter; a kind added to model_shapes.indenters() gets all of these tests."""

from __future__ import annotations

import numpy as np
import pytest
from model_shapes import bolt_mesh, indenters, plain_cast, sphere_mesh

from skincal.model import FlatPunch, Indenter, Sphere

ALL = indenters()
UP = np.array([0.0, 0.0, 1.0])
LEANING = [UP, -UP, np.array([0.48, -0.36, 0.8]), np.array([1.0, 0.0, 0.0])]
ORIGINS = np.random.default_rng(1).uniform(-0.008, 0.008, (500, 3))
every = pytest.mark.parametrize("indenter", ALL.values(), ids=ALL)


@every
def test_it_touches_the_origin_from_above(indenter: Indenter):
    assert indenter.cast(np.zeros((1, 3)), UP).distance_m[0] == pytest.approx(0.0, abs=1e-15)
    distance = indenter.cast(ORIGINS * [1, 1, 0], UP).distance_m
    assert distance.min() >= -1e-15
    assert np.isinf(distance).any()


@every
@pytest.mark.parametrize("direction", LEANING, ids=["up", "down", "leaning", "across"])
def test_a_cast_meets_the_first_surface_of_the_whole_line(indenter: Indenter, direction: np.ndarray):
    hits, far = indenter.cast(ORIGINS, direction), indenter.cast(ORIGINS + 0.05 * direction, direction)
    hit = np.isfinite(hits.distance_m)
    assert hit.sum() > 20 or (isinstance(indenter, FlatPunch) and not direction[2])
    np.testing.assert_allclose(far.distance_m[hit], hits.distance_m[hit] - 0.05, atol=1e-9)
    assert np.all((hits.facing >= 0) & (hits.facing <= 1 + 1e-12))
    assert not hits.facing[~hit].any()
    distance, facing = plain_cast(indenter, ORIGINS, direction)
    np.testing.assert_allclose(hits.distance_m, distance, atol=1e-15)
    np.testing.assert_allclose(hits.facing, facing, atol=1e-12)
    assert indenter.cast(np.zeros((0, 3)), direction).distance_m.shape == (0,)


def test_a_mesh_of_a_ball_tends_to_the_ball():
    origins = ORIGINS * [0.5, 0.5, 0.1]
    exact = Sphere(0.006).cast(origins, UP)
    meshes = [sphere_mesh(level).cast(origins, UP) for level in (2, 3, 4, 5)]
    error = [np.abs(mesh.distance_m - exact.distance_m).max() for mesh in meshes]
    assert np.all(np.divide(error[:-1], error[1:]) > 3)  # about 4 a level
    assert error[-1] < 4e-6
    assert np.abs(meshes[-1].facing - exact.facing).max() < 0.02


def test_first_surface_of_a_shape_that_is_not_convex():
    # The head lies 1.3 mm (an edge: 2 mm) lower than the shaft, whose side is what a ray along x meets behind it.
    hits = bolt_mesh().cast([[0.012, 0.0, 0.0], [0.004, 0.0, 0.0]], UP)
    assert -2.1e-3 < hits.distance_m[0] < -1.3e-3
    assert hits.distance_m[1] == pytest.approx(0.0, abs=1e-12)
    assert bolt_mesh().vertices_m.flags.writeable is False


@pytest.mark.parametrize("kind", [Sphere, FlatPunch])
@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_a_radius_is_a_positive_number(kind, radius):
    with pytest.raises(ValueError, match="radius_m: expected a finite number > 0"):
        kind(radius)
