"""Triangle meshes: checks, and the first triangle on a ray (embree)."""

from __future__ import annotations

import importlib
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.model.arrays import FloatArray, IntArray, check_shape, floats, frozen

_SIZE = 100.0
"""Length of the diagonal that meshes are scaled to: embree's tolerances are absolute lengths."""


class RayScene:
    """Triangles for ray casting, in single precision. The acceleration structure is built at the first ray.

    Args:
        vertices: (V, 3) centred on the origin, so that single precision resolves the shape [m].
        faces: (F, 3) indices of vertices.

    Attributes:
        scale: lengths in the scene over lengths in metres.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        self.scale = _SIZE / float(np.linalg.norm(np.ptp(vertices, axis=0)))
        self._vertices = (vertices * self.scale).astype(np.float32)
        self._faces = faces.astype(np.int32)

    @cached_property
    def _scene(self) -> Any:
        # embreex has no type annotations.
        embree: Any = importlib.import_module("embreex.rtcore_scene")
        meshes: Any = importlib.import_module("embreex.mesh_construction")
        scene = embree.EmbreeScene()
        meshes.TriangleMesh(scene, self._vertices, self._faces)
        return scene

    def first(self, origins: FloatArray, directions: FloatArray) -> IntArray:
        """Return the first triangle (N,) on each ray, -1 where there is none.

        Args:
            origins: (N, 3) where the rays start.
            directions: (N, 3) or (3,) unit vectors.
        """
        starts = (origins * self.scale).astype(np.float32)
        ways = np.empty_like(starts)
        ways[:] = directions
        return self.run(starts, ways).astype(np.int64)

    def run(self, starts: NDArray[np.float32], ways: NDArray[np.float32]) -> NDArray[np.int32]:
        """Return the first triangle (N,) on each ray, -1 without a hit; rays (N, 3) are in the scene's scale."""
        if not len(starts):
            return np.zeros(0, dtype=np.int32)
        return np.asarray(self._scene.run(starts, ways), dtype=np.int32)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without embree's structure: it cannot be pickled, and rebuilding it is fast."""
        return {name: value for name, value in self.__dict__.items() if name != "_scene"}


_FLAT = 1e-12
"""Smallest area of a face with a normal, over the mesh's size squared: a numerical tolerance."""


class TriangleMesh:
    """A mesh and its ray structure, which is built once.

    Equal vertices are merged, since STL files repeat them for every face. Faces without an area are dropped, since no
    ray can hit them. Embree works in single precision and only reports *which* triangle is hit; the hit point is
    computed in double precision. Distances are therefore accurate to about 1e-16 of the mesh's size, not 1e-7.

    Attributes:
        name: name of the mesh, for errors.
        vertices_m: (V, 3) [m].
        faces: (F, 3) indices of vertices.
        normals: (F, 3) unit normals, right-handed with respect to the order of the vertices.
        areas_m2: (F,) areas of the faces [m²].
        centre_m: (3,) centre of the bounding box [m].
        radius_m: largest distance of a vertex from ``centre_m`` [m].
        heights: (F,) signed distances of the faces' planes from the origin, along their normals [m].
        rays: ray structure, centred on ``centre_m``.
    """

    def __init__(self, name: str, vertices_m: ArrayLike, faces: ArrayLike) -> None:
        """Check a mesh and build its ray structure.

        Args:
            name: name of the mesh, for errors.
            vertices_m: (V, 3) vertices [m].
            faces: (F, 3) indices of vertices.

        Raises:
            ValueError: values that are not finite, indices out of range, or no face with an area.
        """
        self.name = name
        vertices = floats(f"{name} vertices_m", vertices_m, (None, 3))
        vertices, corners = _merge_vertices(vertices, _checked_faces(name, faces, len(vertices)))
        self._edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
        size = float(np.ptp(vertices, axis=0).max()) if len(corners) else 0.0
        cross = _face_cross(vertices, corners)
        doubled = np.linalg.norm(cross, axis=1)
        solid = doubled > _FLAT * size**2
        if not solid.any():
            raise ValueError(f"{name}: expected a mesh with at least one face that has an area; got none")
        self.vertices_m = frozen(vertices)
        self.faces = frozen(corners[solid])
        self.normals = frozen(cross[solid] / doubled[solid, None])
        self.areas_m2 = frozen(doubled[solid] / 2)
        self.centre_m = frozen((vertices.min(axis=0) + vertices.max(axis=0)) / 2)
        self.radius_m = float(np.linalg.norm(vertices - self.centre_m, axis=1).max())
        self.heights = frozen(np.sum(self.normals * vertices[self.faces[:, 0]], axis=1))
        self.rays = RayScene(vertices - self.centre_m, self.faces)

    def first_hit(self, origins_m: FloatArray, directions: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the first triangle on each ray.

        Args:
            origins_m: (N, 3) where the rays start [m].
            directions: (N, 3) unit vectors.

        Returns:
            Triangle (N,), -1 where the ray misses, and distance along the ray (N,) [m], inf where it misses.
        """
        if len(origins_m) == 0:
            return np.zeros(0, dtype=np.int64), np.zeros(0)
        face = self.rays.first(origins_m - self.centre_m, directions)
        hit = face >= 0
        normals = self.normals[face]
        closing = np.einsum("ij,ij->i", normals, directions)
        hit &= closing != 0
        ahead = self.heights[face] - np.einsum("ij,ij->i", normals, origins_m)
        distance = np.divide(ahead, closing, out=np.full(len(face), np.inf), where=hit)
        return np.where(hit, face, -1), distance

    def check_closed(self) -> None:
        """Raise ``ValueError`` unless every edge belongs to two faces: through a hole a ray would hit the inside."""
        _, count = np.unique(np.sort(self._edges, axis=1), axis=0, return_counts=True)
        if np.any(count != 2):
            raise ValueError(
                f"{self.name}: expected a closed mesh, two faces at every edge; got {np.sum(count != 2)} edges "
                f"with another number of faces. Close it, or pass closed=False if no hole faces the skin"
            )

    def check_winding(self) -> None:
        """Raise ``ValueError`` unless neighbouring faces have consistent winding, so that "outward" is defined."""
        _, count = np.unique(self._edges, axis=0, return_counts=True)
        if np.any(count > 1):
            raise ValueError(
                f"{self.name}: expected neighbouring faces with consistent winding; got {np.sum(count > 1)} edges that "
                "two faces traverse in the same direction. Repair it, with trimesh.repair.fix_winding for example"
            )


def _checked_faces(name: str, faces: ArrayLike, vertices: int) -> IntArray:
    array = np.asarray(faces)
    check_shape(f"{name} faces", array, (None, 3))
    if array.size and not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"{name} faces: expected whole numbers; got {array.dtype}")
    if array.size and (array.min() < 0 or array.max() >= vertices):
        raise ValueError(
            f"{name} faces: expected indices from 0 to {vertices - 1}; got {array.min()} to {array.max()}"
        )
    return array.astype(np.int64)


def _merge_vertices(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Merge equal vertices, and drop the faces that collapse."""
    unique, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    a, b, c = faces.T
    return unique, faces[(a != b) & (b != c) & (c != a)]


def _face_cross(vertices: FloatArray, faces: IntArray) -> FloatArray:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a)
