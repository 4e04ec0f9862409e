"""A triangle mesh as a fingertip."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, IntArray, floats, positive
from skincal.model.contact import contact_rotations
from skincal.model.mesh import TriangleMesh
from skincal.model.surfaces.surface import SensorPose, Surface
from skincal.model.surfaces.walk import Stand, Walker, corner_normals


class MeshSurface(Surface):
    """A fingertip given as triangles, in the fingertip frame. Its base may be open.

    The patch is mapped along geodesics: a spine runs from the centre along v, and a row runs from every point of the
    spine along u. On a developable surface this is exact up to the discretisation of the mesh. On any other surface a
    real patch wrinkles or stretches; here rows diverge or converge with the distance from the spine. Areas are those of
    the mapped cells.

    Normals are averaged at the vertices over faces that differ by less than ``crease_rad``, so that the mesh of a
    cylinder has the cylinder's normals. At a sharper edge the faces keep their own normals.
    """

    def __init__(
        self,
        vertices_m: ArrayLike,
        faces: ArrayLike,
        *,
        step_m: float = 0.5e-3,
        crease_rad: float = np.pi / 6,
    ) -> None:
        """Check the mesh and build its ray structure.

        Args:
            vertices_m: (V, 3) vertices, fingertip frame [m].
            faces: (F, 3) indices of vertices.
            step_m: length of the steps along geodesics [m].
            crease_rad: smallest angle between faces at a sharp edge [rad].

        Raises:
            ValueError: the mesh has no area, NaN, indices out of range, or inconsistent winding.
        """
        from scipy.spatial import KDTree  # slow import, and few surfaces are meshes

        self._mesh = TriangleMesh("surface mesh", vertices_m, faces)
        self._mesh.check_winding()
        self._outward = _outward_sign(self._mesh)
        self._walker = Walker(self._mesh, corner_normals(self._mesh, crease_rad), positive("step_m", step_m))
        centroids = self._mesh.vertices_m[self._mesh.faces].mean(axis=1)
        self._centroids = KDTree(centroids)
        corners = self._mesh.vertices_m[self._mesh.faces]
        self._face_reach_m = float(np.linalg.norm(corners - centroids[:, None], axis=2).max())

    def wrap(self, pose: SensorPose, uv_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Map points of the patch onto the mesh. See :meth:`Surface.wrap`.

        Points are NaN where a row leaves the mesh. A patch wider than the circumference overlaps itself without an
        error.

        Raises:
            ValueError: there is no mesh at the patch's centre, or its normal is parallel to y, so that "along the
                finger" is undefined.
        """
        u, v = floats("uv_m", uv_m, (None, 2)).T
        rows, row = np.unique(v, return_inverse=True)
        centre = self._centre(pose)
        spine = _walk_both_ways(self._walker, centre, np.zeros(len(rows), dtype=np.int64), rows)
        ends = _walk_both_ways(self._walker, spine.turned_right(), row, u)
        return ends.points_m, ends.normals

    def cell_areas(self, pose: SensorPose, uv_m: ArrayLike, size_m: ArrayLike) -> FloatArray:
        """Return areas (N,) [m²] of the cells from their corners on the mesh. See :meth:`Surface.cell_areas`."""
        uv, half = (floats("uv_m", uv_m, (None, 2)), floats("size_m", size_m, (None, 2)) / 2)
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        corners, _ = self.wrap(pose, (uv + signs[:, None] * half).reshape(-1, 2))
        a, b, c, d = corners.reshape(4, -1, 3)
        # The area of a (nearly) flat quadrilateral is half the cross product of its diagonals.
        return np.linalg.norm(np.cross(c - a, d - b), axis=1) / 2

    def normal_at(self, points_m: ArrayLike) -> FloatArray:
        return self._nearest(points_m).normals

    def project(self, points_m: ArrayLike) -> FloatArray:
        return self._nearest(points_m).points_m

    def offset(self, points_m: ArrayLike, across_m: ArrayLike, along_m: ArrayLike) -> FloatArray:
        """Follow a geodesic from each point; NaN where it leaves the mesh. See :meth:`Surface.offset`."""
        start = self._nearest(points_m)
        count = len(start.points_m)
        across, along = (
            np.broadcast_to(np.asarray(x, dtype=np.float64), (count,)) for x in (across_m, along_m)
        )
        length = np.hypot(across, along)
        frame = contact_rotations(start.normals)
        heading = across[:, None] * frame[:, :, 0] + along[:, None] * frame[:, :, 1]
        heading = np.where(
            length[:, None] > 0, heading / np.where(length > 0, length, 1.0)[:, None], frame[:, :, 1]
        )
        start = Stand(start.points_m, start.normals, heading)
        return self._walker.walk(start, np.arange(count), length).points_m

    def _centre(self, pose: SensorPose) -> Stand:
        """Return the patch's centre, with the heading along v: the first hit of a radial ray from outside."""
        radial = np.array([[np.sin(pose.beta_rad), 0.0, np.cos(pose.beta_rad)]])
        axis = np.array([[0.0, pose.y_m, 0.0]])
        far = 2 * (float(np.linalg.norm(self._mesh.centre_m - axis)) + self._mesh.radius_m)
        face, distance = self._mesh.first_hit(axis + far * radial, -radial)
        if not distance[0] < far:
            raise ValueError(
                f"surface mesh: expected the mesh at the patch's centre, y = {pose.y_m:.6g} m and "
                f"beta = {pose.beta_rad:.6g} rad; got nothing there. Check the pose and the mesh's unit (metres)"
            )
        points = axis + (far - distance)[:, None] * radial
        normals = self._walker.normals(face, points, -radial)
        frame = contact_rotations(normals)
        if abs(normals[0, 1]) > 1 - 1e-9:
            raise ValueError(
                "surface mesh: expected a normal across the finger at the patch's centre; got one along y"
            )
        heading = np.cos(pose.alpha_rad) * frame[:, :, 1] - np.sin(pose.alpha_rad) * frame[:, :, 0]
        return Stand(points, normals, heading)

    def _nearest(self, points_m: ArrayLike) -> Stand:
        """Return nearest points of the mesh with outward normals; headings, and rows of NaN points, are NaN."""
        from trimesh import triangles  # slow import, which only meshes need

        points = floats("points_m", points_m, (None, 3), finite=False)
        nearest, normals = np.full(points.shape, np.nan), np.full(points.shape, np.nan)
        known = np.flatnonzero(np.isfinite(points).all(axis=1))
        if len(known):
            candidates, owner = self._candidates(points[known])
            corners, each = self._mesh.vertices_m[self._mesh.faces[candidates]], points[known][owner]
            on_face: FloatArray = triangles.closest_point(corners, each)  # pyright: ignore[reportUnknownMemberType]
            order = np.lexsort((np.sum((on_face - each) ** 2, axis=1), owner))
            best = order[np.searchsorted(owner[order], np.arange(len(known)))]
            face, nearest[known] = candidates[best], on_face[best]
            inward = -self._outward * self._mesh.normals[face]
            normals[known] = self._walker.normals(face, nearest[known], inward)
        return Stand(nearest, normals, np.full(points.shape, np.nan))

    def _candidates(self, points: FloatArray) -> tuple[IntArray, IntArray]:
        """Return the faces that may contain the nearest points (K, 3), (M,), and the number of the point of each, (M,).

        The centroid of such a face is no farther than the nearest centroid plus the largest extent of a face.
        """
        distance, _ = self._centroids.query(points)
        reach = (distance + self._face_reach_m) * (1 + 1e-9)
        faces = cast("list[list[int]]", self._centroids.query_ball_point(points, reach))
        owner = np.repeat(np.arange(len(points)), [len(one) for one in faces])
        return np.concatenate(faces).astype(np.int64), owner


def _walk_both_ways(walker: Walker, start: Stand, which: IntArray, length_m: FloatArray) -> Stand:
    """Walk signed lengths (M,) [m]: negative ones go backwards, and the heading at the end still points forwards."""
    count = len(start.points_m)
    both = Stand(
        np.concatenate([start.points_m] * 2),
        np.concatenate([start.normals] * 2),
        np.concatenate([start.heading, -start.heading]),
    )
    back = length_m < 0
    ends = walker.walk(both, which + count * back, np.abs(length_m))
    return Stand(ends.points_m, ends.normals, np.where(back[:, None], -1.0, 1.0) * ends.heading)


def _outward_sign(mesh: TriangleMesh) -> float:
    """Return +1 if the faces' normals point out of the finger, else -1 (the sign of the enclosed volume)."""
    middle = mesh.vertices_m[mesh.faces].mean(axis=1) - mesh.centre_m
    return 1.0 if np.sum(mesh.areas_m2 * np.einsum("ij,ij->i", middle, mesh.normals)) >= 0 else -1.0
