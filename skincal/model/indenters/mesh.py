"""A triangle mesh as an indenter."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, IntArray, as_floats
from skincal.model.indenters.indenter import Indenter, RayHits
from skincal.model.mesh import TriangleMesh

_MOST_PARTS = 4
"""Largest number of connected parts that are bounded separately; a mesh of more parts is bounded as a whole."""
_SLENDER = 0.5
"""Largest ratio of the spread across to the spread along the long axis of a part that counts as long."""


class MeshIndenter(Indenter):
    """A rigid body given as triangles, in its own frame.

    The ray structure is built once; rays are transformed into the frame of the mesh. The winding of the faces does not
    matter.

    Resolution: a ball of 6 mm radius as an icosphere of 1280, 5120 and 20480 faces (edges of 0.9, 0.44 and 0.22 mm)
    gives taxel loads that differ from the closed form by 1.5e-4, 4e-5 and 2e-5 of the force (root mean square). The
    error falls with the square of the edge length, and linearly once edges are shorter than the patch's cells.

    Attributes:
        radius_m: see :class:`Indenter`.
        mesh: the triangles and their ray structure.
        ahead: search depth of the next press, over the penetration that the bound of the mesh predicts. It adapts from
            press to press to save rays, and does not change results.
        upright: bounds of the mesh for presses without rotations, computed at first use.
    """

    def __init__(self, vertices_m: ArrayLike, faces: ArrayLike, *, closed: bool = True) -> None:
        """Check the mesh and build its ray structure.

        Args:
            vertices_m: (V, 3) vertices [m]. To press with the default contact frame, the mesh must touch
                z = 0 at the origin from above.
            faces: (F, 3) indices of vertices.
            closed: refuse a mesh with holes, through which rays would hit the inside. Pass False for a scan whose
                open side never faces the skin.

        Raises:
            ValueError: the mesh has no area, NaN, indices out of range, or holes.
        """
        self.mesh = TriangleMesh("indenter mesh", vertices_m, faces)
        if closed:
            self.mesh.check_closed()
        self.radius_m = float(np.ptp(self.mesh.vertices_m, axis=0).min()) / 2
        self.ahead = 1.1
        self.upright: FloatArray | None = None

    @property
    def vertices_m(self) -> FloatArray:
        """(V, 3) merged vertices [m]."""
        return self.mesh.vertices_m

    @property
    def depth_m(self) -> float:
        """Half the shortest side of the bounding box [m]."""
        return self.radius_m

    def resized(self, factor: float) -> MeshIndenter:
        return MeshIndenter(factor * self.vertices_m, self.mesh.faces, closed=False)

    def cast(self, origins_m: ArrayLike, direction: ArrayLike) -> RayHits:
        origins, way = as_floats(origins_m), as_floats(direction)
        start = (self.mesh.centre_m - origins) @ way - 1.01 * self.mesh.radius_m
        directions = np.broadcast_to(way, origins.shape)
        face, distance = self.mesh.first_hit(origins + start[:, None] * way, directions)
        return RayHits(start + distance, np.where(face >= 0, np.abs(self.mesh.normals[face] @ way), 0.0))

    @cached_property
    def hulls(self) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
        """Convex hulls of the connected parts, as the arguments of ``skincal.model.press.casting.enclose``."""
        from scipy.sparse import csr_array  # slow import, and few indenters are meshes
        from scipy.sparse.csgraph import connected_components

        vertices, edges = self.mesh.vertices_m, self.mesh.faces[:, [0, 1, 2]]
        ends = edges.ravel(), np.roll(edges, -1, axis=1).ravel()
        graph = csr_array((np.ones(edges.size), ends), shape=(len(vertices), len(vertices)))
        found, part = connected_components(graph, directed=False)
        used = np.bincount(part[edges[:, 0]], minlength=found) > 0
        names = np.flatnonzero(used)
        groups = [vertices[part == name] for name in names] if len(names) <= _MOST_PARTS else [vertices]
        hulls = [_hull(group) for group in groups]
        starts = np.cumsum([0, *map(len, hulls)])
        middles = np.array([(hull.min(axis=0) + hull.max(axis=0)) / 2 for hull in hulls])
        return np.concatenate(hulls), starts, np.array([_long_axis(hull) for hull in hulls]), middles


def _hull(vertices: FloatArray) -> FloatArray:
    """Return the vertices of the convex hull; all vertices if the mesh is flat and has no hull."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return vertices[ConvexHull(vertices).vertices]
    except QhullError:
        return vertices


def _long_axis(vertices: FloatArray) -> FloatArray:
    """Return the principal axis of vertices (V, 3), and 1 if the part is long, else 0: (4,)."""
    spread = np.linalg.eigh(np.cov(vertices.T))
    slender = spread.eigenvalues[1] < _SLENDER**2 * spread.eigenvalues[2]
    return np.append(spread.eigenvectors[:, -1], float(slender))
