"""Any triangle mesh as an indenter."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError

from skincal.model.arrays import FloatArray, IntArray
from skincal.model.indenters.base import Indenter, RayHits
from skincal.model.indenters.bound import Bound, frames
from skincal.model.mesh import TriangleMesh

_SLACK = 0.01
"""How far before the nearest vertex the bounding paraboloid starts, in parts of the mesh's radius."""
_TINY_M2 = 1e-30
"""Keeps a vertex on the axis from dividing by zero."""
_WIDER = 1 + 1e-9
"""Rounding must not leave out a point at the very rim."""


class MeshIndenter(Indenter):
    """A rigid body given as triangles, in its own frame.

    Its ray structure is built once; rays are moved into its frame, never the mesh into theirs. Normals are those
    of the faces, turned against the ray, so the winding of the faces does not matter.

    How fine it should be: a ball of 6 mm radius as an icosphere of 1280, 5120 and 20480 faces (edges of 0.9, 0.44
    and 0.22 mm) gives taxel loads that differ from the closed form by 1.5e-4, 4e-5 and 2e-5 of the force (root mean
    square). The error falls with the square of the edges, and linearly once they are shorter than the patch's cells.
    """

    def __init__(self, vertices_m: ArrayLike, faces: ArrayLike, *, closed: bool = True) -> None:
        """Check the mesh and build its ray structure.

        Args:
            vertices_m: (V, 3) vertices [m]. To press with the default contact frame, the mesh must touch
                z = 0 at the origin from above.
            faces: (F, 3) indices of vertices.
            closed: refuse a mesh with holes, through which rays would meet its inside. Say False for a scan
                whose open side never faces the skin.

        Raises:
            ValueError: a mesh without any area, with NaN, with indices out of range, or with holes.
        """
        self._mesh = TriangleMesh("indenter mesh", vertices_m, faces)
        if closed:
            self._mesh.check_closed()
        self._hull_m = _hull(self._mesh.vertices_m)
        self._long_axis = _long_axis(self._hull_m)
        # The frame of every press without rotations: worked out once.
        self._upright = self._paraboloid(np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 3)))

    @property
    def vertices_m(self) -> FloatArray:
        """(V, 3) merged vertices [m]."""
        return self._mesh.vertices_m

    @property
    def identity(self) -> tuple[FloatArray, IntArray]:
        """All that it is made of: two with the same are the same."""
        return self._mesh.vertices_m, self._mesh.faces

    @property
    def depth_m(self) -> float:
        """See :attr:`Indenter.depth_m`: half the shortest side of the box round it."""
        return float(np.ptp(self._mesh.vertices_m, axis=0).min()) / 2

    def cast(self, origins_m: ArrayLike, direction: ArrayLike) -> RayHits:
        """See :meth:`Indenter.cast`."""
        origins = np.asarray(origins_m, dtype=np.float64)
        directions = np.broadcast_to(np.asarray(direction, dtype=np.float64), origins.shape)
        face, distance = self._mesh.first_on_line(origins.reshape(-1, 3), directions.reshape(-1, 3))
        normals = np.where(face[:, None] >= 0, self._mesh.normals[face], np.nan).reshape(origins.shape)
        closing = np.einsum("...i,...i->...", normals, directions)[..., None]
        return RayHits(distance.reshape(origins.shape[:-1]), -np.sign(closing) * normals)

    def along(self, origins_m: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Indenter.along`."""
        return self._mesh.first_ahead(origins_m, direction)

    def bound(self, directions: FloatArray, contacts_m: FloatArray) -> Bound:
        """See :meth:`Indenter.bound`. About the contact.

        What lies behind a paraboloid is a convex set: where all vertices are in it, so are the faces.
        """
        if not contacts_m.any() and np.all(directions == [0.0, 0.0, 1.0]):
            return self._upright[np.zeros(len(directions), dtype=np.int64)]
        return self._paraboloid(directions, contacts_m)

    def _paraboloid(self, directions: FloatArray, contacts_m: FloatArray) -> Bound:
        """The tightest paraboloids that start a little before the nearest vertex.

        Without that little, a contact in the middle of a face would flatten them.
        """
        frame = frames(directions, self._long_axis)
        place = frame @ self._hull_m.T - frame @ contacts_m[:, :, None]
        aside_2 = place[:, :2] ** 2
        aside_2 = np.concatenate([aside_2.sum(axis=1, keepdims=True), aside_2], axis=1)
        nearest = place[:, 2].min(axis=1) - _SLACK * self._mesh.radius_m
        height = place[:, 2] - nearest[:, None]
        bend = np.min(height[:, None] / np.maximum(aside_2, _TINY_M2), axis=2)
        return Bound(contacts_m, frame, nearest, bend, _WIDER * np.sqrt(aside_2.max(axis=2)))


def _hull(vertices: FloatArray) -> FloatArray:
    """The vertices of the convex hull; all of them where there is none, as the mesh is flat."""
    try:
        return vertices[ConvexHull(vertices).vertices]
    except QhullError:
        return vertices


def _long_axis(vertices: FloatArray) -> FloatArray:
    """The direction (3,) in which vertices (V, 3) spread furthest."""
    return np.linalg.eigh(np.cov(vertices.T)).eigenvectors[:, -1]
