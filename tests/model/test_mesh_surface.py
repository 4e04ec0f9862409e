from __future__ import annotations

import numpy as np
import pytest
import trimesh
from model_shapes import cylinder_mesh, surface_of
from published import FINGER, LAYOUT, RADIUS_M

from skincal.model import MeshSurface, Patch, SensorPose

POSE = SensorPose(0.0235, 0.3, beta_rad=0.05)


def _errors(sections: int) -> tuple[float, float, float]:
    """Largest error of place [m], normal [-] and area [-] of the paper's patch on a mesh of the finger."""
    exact = Patch.build(FINGER, LAYOUT, POSE, resolution_m=0.5e-3)
    patch = Patch.build(surface_of(cylinder_mesh(sections)), LAYOUT, POSE, resolution_m=0.5e-3)
    return (
        np.linalg.norm(patch.points_m - exact.points_m, axis=1).max(),
        np.linalg.norm(patch.normals - exact.normals, axis=1).max(),
        np.abs(patch.areas_m2 / exact.areas_m2 - 1).max(),
    )


def test_a_cylinder_mesh_converges_at_second_order():
    errors = np.array([_errors(sections) for sections in (16, 32, 64, 128)])
    # 270, 75, 20 and 6 um at 15 mm from the centre; 0.9 to 0.03 degrees; 2 % to 0.06 %.
    assert np.all(errors[:-1] / errors[1:] > 2.7)
    assert errors[-1, 0] < 8e-6
    assert errors[-1, 1] < np.radians(0.04)
    assert errors[-1, 2] < 1e-3


def test_finer_steps_take_the_rest_of_the_error():
    exact, _ = FINGER.wrap(POSE, [[14e-3, -14e-3]])
    error = [
        np.linalg.norm(surface_of(cylinder_mesh(2048), step_m=step).wrap(POSE, [[14e-3, -14e-3]])[0] - exact)
        for step in (1e-3, 0.25e-3)
    ]
    assert error[1] < 0.5e-6
    assert error[0] > 8 * error[1]


def test_a_patch_over_an_edge_of_faces_as_well_as_between_them():
    # beta = 0 lies on an edge of the mesh, where a ray could slip through.
    for beta in (0.0, np.pi / 64, 2 * np.pi / 64):
        points, _ = surface_of(cylinder_mesh(64)).wrap(
            SensorPose(0.03, 0.0, beta), [[0.0, 0.0], [1e-3, 2e-3]]
        )
        exact, _ = FINGER.wrap(SensorPose(0.03, 0.0, beta), [[0.0, 0.0], [1e-3, 2e-3]])
        np.testing.assert_allclose(points, exact, atol=2e-5)


def test_rows_on_a_ball_are_great_circles_across_the_spine():
    radius = 0.012
    ball = trimesh.creation.icosphere(5, radius=radius).apply_translation([0.0, 0.02, 0.0])
    surface = surface_of(ball)
    u, v = 6e-3, 5e-3
    points, normals = surface.wrap(SensorPose(0.02, 0.0), [[u, v], [0.0, -v], [-u, v]])
    spine = np.array([0.0, np.sin(v / radius), np.cos(v / radius)])
    side = np.array([1.0, 0.0, 0.0])
    expected = np.array(
        [
            np.cos(u / radius) * spine + np.sin(u / radius) * side,
            [0.0, -np.sin(v / radius), np.cos(v / radius)],
            np.cos(u / radius) * spine - np.sin(u / radius) * side,
        ]
    )
    np.testing.assert_allclose(points, radius * expected + [0.0, 0.02, 0.0], atol=10e-6)
    np.testing.assert_allclose(normals, expected, atol=2e-3)
    # Cells away from the spine are narrower along v: rows come together like meridians.
    area = surface.cell_areas(SensorPose(0.02, 0.0), [[u, 0.0]], [[0.25e-3, 0.25e-3]])
    assert area[0] / 0.25e-3**2 == pytest.approx(np.cos(u / radius), rel=0.01)


def test_the_base_may_be_open_and_the_winding_either_way():
    mesh = cylinder_mesh(64, open_base=True)
    assert not mesh.is_watertight
    inside_out = MeshSurface(mesh.vertices, mesh.faces[:, ::-1])
    points = np.array([[0.0, 0.02, RADIUS_M], [0.003, 0.03, 0.011]])
    np.testing.assert_allclose(inside_out.normal_at(points), FINGER.normal_at(points), atol=1e-2)
    np.testing.assert_allclose(
        inside_out.wrap(POSE, [[3e-3, 0.0]])[1], FINGER.wrap(POSE, [[3e-3, 0.0]])[1], atol=1e-2
    )


def test_a_real_edge_stays_an_edge():
    surface = surface_of(cylinder_mesh(64))
    end = surface.normal_at([[0.002, 0.0701, 0.003], [0.0, 0.0699, RADIUS_M]])
    np.testing.assert_allclose(end, [[0, 1, 0], [0, 0, 1]], atol=1e-2)


def test_a_walk_off_the_mesh_has_no_end():
    surface = surface_of(cylinder_mesh(64))
    moved = surface.offset([[0.0, 0.068, RADIUS_M]] * 2, 0.0, [1e-3, 3e-3])
    assert np.isfinite(moved[0]).all()
    assert np.isnan(moved[1]).all()


def test_the_nearest_point_is_found_on_long_thin_faces():
    surface = surface_of(cylinder_mesh(16))
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.02, 0.0, -0.02], [0.02, 0.06, 0.02], (50, 3))
    mesh = cylinder_mesh(16)
    for point, found in zip(points, surface.project(points), strict=True):
        on_each = trimesh.triangles.closest_point(mesh.triangles, np.tile(point, (len(mesh.faces), 1)))
        assert np.linalg.norm(found - point) == pytest.approx(
            np.linalg.norm(on_each - point, axis=1).min(), abs=1e-12
        )


@pytest.mark.parametrize("pose", [SensorPose(0.2, 0.0), SensorPose(-0.02, 0.0)])
def test_a_pose_off_the_mesh_is_refused(pose):
    with pytest.raises(
        ValueError, match=r"expected the mesh at the patch's centre.*the mesh's unit \(metres\)"
    ):
        surface_of(cylinder_mesh(32)).wrap(pose, [[0.0, 0.0]])


def test_faces_wound_both_ways_are_refused():
    mesh = cylinder_mesh(16)
    faces = np.array(mesh.faces)
    faces[::3] = faces[::3, ::-1]
    with pytest.raises(
        ValueError, match="surface mesh: expected neighbouring faces with consistent winding; got"
    ):
        MeshSurface(mesh.vertices, faces)


@pytest.mark.parametrize("step", [0.0, np.nan])
def test_a_step_needs_a_length(step):
    with pytest.raises(ValueError, match="step_m: expected a finite number > 0"):
        surface_of(cylinder_mesh(16), step_m=step)
