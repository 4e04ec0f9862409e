"""Patches of one layout at many poses: what does not depend on the pose is worked out once."""

from __future__ import annotations

import numpy as np

from skincal.model import Patch, SensorPose, Surface, TaxelLayout
from skincal.model.arrays import frozen
from skincal.model.tiles import Tiles

_MARGIN_M = 8e-3


class PatchMould:
    """Lays the same cells on a surface at one pose after the other.

    The patches are those of :meth:`skincal.model.Patch.build`; the compact groups, that only spare rays, are those
    found at one pose, as neighbours stay neighbours.

    Args:
        surface: the fingertip, one that can be unrolled: areas stay what they are.
        layout: the taxels.
        resolution_m: longest edge of a cell [m].
        margin_m: how far the skin goes on around the taxels [m].
    """

    def __init__(
        self,
        surface: Surface,
        layout: TaxelLayout,
        resolution_m: float = 0.25e-3,
        margin_m: float = _MARGIN_M,
    ) -> None:
        self._surface = surface
        self._layout = layout
        self._size = (resolution_m, margin_m)
        # Always at the same pose: the order of sums must not depend on what was asked for before.
        self._first = self._build(SensorPose(0.0, 0.0))

    def at(self, pose: SensorPose) -> Patch:
        """The patch at a pose.

        Raises:
            ValueError: a taxel has no place on the surface.
        """
        first = self._first
        assert first.uv_m is not None
        points, normals = self._surface.wrap(pose, first.uv_m)
        if not np.isfinite(points).all():
            return self._build(pose)
        patch = Patch(points, normals, first.areas_m2, first.taxel, first.layout, first.border, first.uv_m)
        # A cached property, filled before it is asked for.
        patch.__dict__["tiles"] = _moved(first.tiles, patch)
        return patch

    def _build(self, pose: SensorPose) -> Patch:
        return Patch.build(self._surface, self._layout, pose, *self._size)


def _moved(tiles: Tiles, patch: Patch) -> Tiles:
    """The same groups of the same points at other places."""
    points = tiles.points.copy()
    # What is there twice, the second time without an area, stays without one.
    there = (tiles.points[..., 5:] != 0).any(axis=2)
    points[..., :3] = patch.points_m[tiles.index]
    points[..., 5:] = (patch.normals * patch.areas_m2[:, None])[tiles.index] * there[..., None]
    place = points[..., :3]
    centres = (place.min(axis=1) + place.max(axis=1)) / 2
    radii = np.linalg.norm(place - centres[:, None], axis=2).max(axis=1)
    return Tiles(
        frozen(points), tiles.taxel, tiles.index, frozen(centres.T.copy()), frozen(radii),
        frozen(points[..., 5:].sum(axis=1)),
    )  # fmt: skip
