"""Meshes as they come out of files: repeated vertices, faces without area, holes, nonsense."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh

from skincal.model import MeshIndenter, MeshSurface

BOX = trimesh.creation.box((0.01, 0.01, 0.01))
UP = np.array([0.0, 0.0, 1.0])
ORIGINS = np.array([[0.0, 0.0, -0.1], [0.001, 0.002, -0.1], [0.02, 0.0, -0.1]])


@pytest.mark.parametrize("kind", [MeshIndenter, MeshSurface])
@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (
            np.where(np.eye(8, 3) > 0, np.nan, BOX.vertices),
            BOX.faces,
            "vertices_m: expected finite numbers; got 3",
        ),
        (BOX.vertices[:, :2], BOX.faces, r"vertices_m: expected shape \('any', 3\); got \(8, 2\)"),
        (BOX.vertices, BOX.faces[:, :2], r"faces: expected shape \('any', 3\); got \(12, 2\)"),
        (BOX.vertices, BOX.faces + 1, "faces: expected indices from 0 to 7; got 1 to 8"),
        (BOX.vertices, np.array(BOX.faces, dtype=float), "faces: expected whole numbers; got float64"),
        (BOX.vertices, np.zeros((0, 3), dtype=int), "at least one face that has an area; got none"),
        (BOX.vertices * [1.0, 0.0, 0.0], BOX.faces, "at least one face that has an area; got none"),
        (np.zeros((0, 3)), np.zeros((0, 3), dtype=int), "at least one face that has an area; got none"),
    ],
)
def test_what_is_no_mesh_is_refused(kind, vertices, faces, message):
    with pytest.raises(ValueError, match=message):
        kind(vertices, faces)


def test_repeated_vertices_as_in_stl_files_are_merged():
    soup = MeshIndenter(BOX.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3))
    assert len(soup.vertices_m) == 8
    np.testing.assert_allclose(soup.cast(ORIGINS, UP).distance_m, [0.095, 0.095, np.inf])


def test_faces_without_area_are_left_out():
    vertices = np.concatenate([BOX.vertices, [BOX.vertices[BOX.faces[0]].mean(axis=0)]])
    slivers = np.array([[0, 0, 1], [0, 1, 1]])
    whole = MeshIndenter(vertices, np.concatenate([BOX.faces, slivers]))
    np.testing.assert_allclose(whole.cast(ORIGINS, UP).distance_m, [0.095, 0.095, np.inf])


def test_a_mesh_with_holes_must_be_asked_for():
    with pytest.raises(ValueError, match=r"indenter mesh: expected a closed mesh.*got 4 edges.*closed=False"):
        MeshIndenter(BOX.vertices, BOX.faces[BOX.face_normals[:, 2] < 0.5])
    open_on_top = MeshIndenter(BOX.vertices, BOX.faces[BOX.face_normals[:, 2] < 0.5], closed=False)
    np.testing.assert_allclose(open_on_top.cast(ORIGINS, UP).distance_m, [0.095, 0.095, np.inf])


def test_a_flat_mesh_is_a_mesh():
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.005
    plate = MeshIndenter(square, [[0, 1, 2], [0, 2, 3]], closed=False)
    np.testing.assert_allclose(plate.cast(ORIGINS, UP).distance_m, [0.1, 0.1, np.inf])


def test_the_winding_of_an_indenter_does_not_matter():
    flipped = MeshIndenter(BOX.vertices, BOX.faces[:, ::-1])
    hits = flipped.cast(ORIGINS[:2], UP)
    np.testing.assert_array_equal([hits.distance_m, hits.facing], [[0.095, 0.095], [1.0, 1.0]])


def test_rays_do_not_slip_through_edges_and_corners():
    along = np.linspace(-0.0049, 0.0049, 2001)
    for x, y in ((along, along), (along, -along), (along, 0 * along)):
        hits = MeshIndenter(BOX.vertices, BOX.faces).cast(np.stack([x, y, x * 0 - 0.1], axis=1), UP)
        np.testing.assert_allclose(hits.distance_m, 0.095, rtol=1e-12)
    ball = trimesh.creation.icosphere(3, radius=0.006)
    below = np.concatenate([ball.vertices, ball.vertices[ball.edges_unique].mean(axis=1)])
    below = below[below[:, 2] < -0.001]
    hits = MeshIndenter(ball.vertices, ball.faces).cast(below * [1, 1, 0] - [0, 0, 0.1], UP)
    np.testing.assert_allclose(hits.distance_m, below[:, 2] + 0.1, atol=1e-9)


def test_a_mesh_far_from_its_origin_keeps_its_accuracy():
    far = np.array([10.0, -20.0, 30.0])
    ball = trimesh.creation.icosphere(4, radius=0.006)
    near, moved = MeshIndenter(ball.vertices, ball.faces), MeshIndenter(ball.vertices + far, ball.faces)
    origins = np.random.default_rng(0).uniform(-0.003, 0.003, (200, 3))
    np.testing.assert_allclose(
        moved.cast(origins + far, UP).distance_m, near.cast(origins, UP).distance_m, atol=1e-10
    )


@pytest.mark.parametrize("kind", [MeshIndenter, MeshSurface])
def test_a_mesh_can_be_sent_to_another_process(kind):
    mesh = kind(BOX.vertices, BOX.faces)
    copy = pickle.loads(pickle.dumps(mesh))
    if kind is MeshIndenter:
        np.testing.assert_array_equal(copy.cast(ORIGINS, UP).distance_m, mesh.cast(ORIGINS, UP).distance_m)
    else:
        np.testing.assert_array_equal(copy.project(ORIGINS), mesh.project(ORIGINS))
