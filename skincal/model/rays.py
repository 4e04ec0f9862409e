"""First triangles on rays: embree, asked directly."""

from __future__ import annotations

import importlib
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.model.arrays import FloatArray, IntArray

_SIZE = 100.0
"""Meshes are scaled to this diagonal, as embree's tolerances are absolute lengths."""


class RayScene:
    """Triangles that rays are cast at, in single precision. The structure is built at the first ray.

    Args:
        vertices: (V, 3) about the origin, so that digits are spent on the shape and not on where it lies.
        faces: (F, 3) indices of vertices.

    Attributes:
        scale: of the scene: lengths in it over lengths outside.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        self.scale = _SIZE / float(np.linalg.norm(np.ptp(vertices, axis=0)))
        self._vertices = (vertices * self.scale).astype(np.float32)
        self._faces = faces.astype(np.int32)

    @cached_property
    def _scene(self) -> Any:
        # It says nothing of its types.
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
        """Return what :meth:`first` does, for rays (N, 3) in the scene's own scale and precision."""
        if not len(starts):
            return np.zeros(0, dtype=np.int32)
        return np.asarray(self._scene.run(starts, ways), dtype=np.int32)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out embree's structure, which cannot be sent to another process and is soon built."""
        return {name: value for name, value in self.__dict__.items() if name != "_scene"}
