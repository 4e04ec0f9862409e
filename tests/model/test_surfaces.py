"""Properties of every surface; a kind added to SURFACES gets all of these tests."""

from __future__ import annotations

import numpy as np
import pytest
from model_shapes import cylinder_mesh, surface_of
from published import FINGER, LAYOUT, RADIUS_M

from skincal.model import Cylinder, Plane, SensorPose, patch_cells

# Each with the error its own form makes [m].
SURFACES = {
    "cylinder": (FINGER, 1e-12),
    "plane": (Plane(), 1e-12),
    "mesh": (surface_of(cylinder_mesh(256)), 6e-6),
}
POSES = [
    SensorPose(0.02, 0.0),
    SensorPose(0.025, 0.5, beta_rad=0.3, x_m=0.002),
    SensorPose(0.03, -2.0, beta_rad=-1.5),
]
UV = np.random.default_rng(5).uniform(-12e-3, 12e-3, (60, 2))
surfaces = pytest.mark.parametrize(("surface", "tolerance_m"), SURFACES.values(), ids=SURFACES)
poses = pytest.mark.parametrize("pose", POSES)


@surfaces
@poses
def test_wrapped_points_lie_on_the_surface_with_its_normals(surface, tolerance_m, pose):
    points, normals = surface.wrap(pose, UV)
    np.testing.assert_allclose(surface.project(points), points, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    np.testing.assert_allclose(surface.normal_at(points), normals, atol=1e-6)


@surfaces
@poses
def test_the_patchs_axes_turn_right_handed_about_the_normal(surface, tolerance_m, pose):
    step = 1e-4
    points, normals = surface.wrap(pose, [[0.0, 0.0], [step, 0.0], [0.0, step]])
    u, v = points[1] - points[0], points[2] - points[0]
    np.testing.assert_allclose(np.cross(u, v) / step**2, normals[0], atol=2e-2)
    along_at_zero = (
        surface.wrap(SensorPose(pose.y_m, 0.0, pose.beta_rad, pose.x_m), [[0.0, step]])[0][0] - points[0]
    )
    np.testing.assert_allclose(along_at_zero / step, [0.0, 1.0, 0.0], atol=2e-2)
    turn = np.arctan2(np.cross(along_at_zero, v) @ normals[0], along_at_zero @ v)
    assert np.angle(np.exp(1j * (turn - pose.alpha_rad))) == pytest.approx(0.0, abs=5e-3)


@surfaces
@poses
def test_neighbours_keep_their_distance(surface, tolerance_m, pose):
    first, _ = surface.wrap(pose, UV)
    second, _ = surface.wrap(pose, UV + np.array([1e-3, 0.0]))
    np.testing.assert_allclose(
        np.linalg.norm(second - first, axis=1), 1e-3, rtol=2e-3 + 2 * tolerance_m / 1e-3
    )


@surfaces
def test_a_place_does_not_depend_on_what_else_is_laid(surface, tolerance_m):
    all_points, _ = surface.wrap(POSES[1], UV)
    some, _ = surface.wrap(POSES[1], UV[::7])
    np.testing.assert_allclose(some, all_points[::7], atol=1e-12)


@surfaces
def test_offset_there_and_back(surface, tolerance_m):
    points, _ = surface.wrap(POSES[1], UV)
    moved = surface.offset(points, 1.5e-3, -0.8e-3)
    np.testing.assert_allclose(np.linalg.norm(moved - points, axis=1), np.hypot(1.5e-3, 0.8e-3), rtol=5e-3)
    assert np.all(moved[:, 1] < points[:, 1])
    np.testing.assert_allclose(
        surface.offset(moved, -1.5e-3, 0.8e-3), points, atol=max(1e-12, 2 * tolerance_m)
    )


@surfaces
def test_offset_by_nothing_projects(surface, tolerance_m):
    points, normals = surface.wrap(POSES[0], UV)
    np.testing.assert_allclose(
        surface.offset(points + 1e-4 * normals, 0.0, 0.0), points, atol=max(1e-12, tolerance_m)
    )


@surfaces
def test_points_with_nan_stay_nan(surface, tolerance_m):
    points = np.array([[0.0, 0.02, RADIUS_M], [np.nan, 0.02, 0.0]])
    for result in (surface.project(points), surface.normal_at(points), surface.offset(points, 1e-3, 0.0)):
        assert np.isfinite(result[0]).all()
        assert np.isnan(result[1]).any() or isinstance(surface, Plane)


@surfaces
@poses
def test_a_surface_that_can_be_unrolled_keeps_areas(surface, tolerance_m, pose):
    uv, size = patch_cells(LAYOUT, 1e-3, 5e-3)
    np.testing.assert_allclose(surface.cell_areas(pose, uv, size), size.prod(axis=1), rtol=2e-3)


@surfaces
def test_wrapping_nothing_gives_nothing(surface, tolerance_m):
    points, normals = surface.wrap(POSES[0], np.zeros((0, 2)))
    assert points.shape == normals.shape == (0, 3)


@surfaces
def test_patch_coordinates_must_be_pairs(surface, tolerance_m):
    with pytest.raises(ValueError, match=r"uv_m: expected shape \('any', 2\)"):
        surface.wrap(POSES[0], np.zeros((3, 3)))


def test_offset_on_the_cylinder_is_along_the_arc():
    moved = FINGER.offset([[0.0, 0.02, RADIUS_M]], [RADIUS_M * np.pi / 2], [0.003])
    np.testing.assert_allclose(moved, [[RADIUS_M, 0.023, 0.0]], atol=1e-15)


def test_beyond_half_a_turn_there_is_no_place():
    points, _ = FINGER.wrap(
        SensorPose(0.0, 0.0), [[0.99 * np.pi * RADIUS_M, 0.0], [1.01 * np.pi * RADIUS_M, 0.0]]
    )
    assert np.isfinite(points[0]).all()
    assert np.isnan(points[1]).all()


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_a_cylinder_needs_a_radius(radius):
    with pytest.raises(ValueError, match="cylinder radius_m: expected a finite number > 0"):
        Cylinder(radius)
