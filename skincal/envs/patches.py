"""Patches of one layout at many poses: what does not depend on the pose is worked out once."""

from __future__ import annotations

import numpy as np

from skincal.model import Cylinder, Patch, SensorPose, TaxelLayout
from skincal.model.arrays import frozen
from skincal.model.tiles import Tiles

_MARGIN_M = 8e-3
_WIDER = 1 + 1e-9
"""Rounding must not leave out a point at the very rim."""
_THIN_M = 1e-12
"""Nor one of a group that is flat [m]."""


class PatchMould:
    """Lays the same cells on a cylinder at one pose after the other.

    The patches are those of :meth:`skincal.model.Patch.build`; the compact groups, that only spare rays, are those
    found at one pose, as neighbours stay neighbours.

    Args:
        surface: the fingertip.
        layout: the taxels.
        resolution_m: longest edge of a cell [m].
        margin_m: how far the skin goes on around the taxels [m].
    """

    def __init__(
        self,
        surface: Cylinder,
        layout: TaxelLayout,
        resolution_m: float = 0.25e-3,
        margin_m: float = _MARGIN_M,
    ) -> None:
        self._surface = surface
        # Always at the same pose: the order of sums must not depend on what was asked for before.
        first = Patch.build(surface, layout, SensorPose(0.0, 0.0), resolution_m, margin_m)
        assert first.uv_m is not None
        self._first, self._uv_m, tiles = first, first.uv_m, first.tiles
        # What is there twice, the second time without an area, stays without one.
        there = (tiles.points[..., 5:] != 0).any(axis=2)
        self._areas_m2 = (first.areas_m2[tiles.index] * there)[..., None]
        places = self._uv_m[tiles.index]
        self._middles_m = (places.min(axis=1) + places.max(axis=1)) / 2
        # On the unrolled surface; as the crow flies it is nearer.
        away = np.linalg.norm(places - self._middles_m[:, None], axis=2).max(axis=1)
        self._radii_m = frozen(away * _WIDER)
        # Wherever the cylinder's axis runs, nothing is bent more than what lies across it.
        bent = surface.radius_m * (1 - np.cos(away / surface.radius_m))
        self._thickness_m = frozen(bent * _WIDER + _THIN_M)

    def at(self, pose: SensorPose) -> Patch:
        """The patch at a pose."""
        first = self._first
        points, normals = self._surface.wrap(pose, self._uv_m)
        patch = Patch(points, normals, first.areas_m2, first.taxel, first.layout, first.border, self._uv_m)
        # A cached property, filled before it is asked for.
        patch.__dict__["tiles"] = self._tiles(patch, pose)
        return patch

    def _tiles(self, patch: Patch, pose: SensorPose) -> Tiles:
        """The same groups of the same points at their new places."""
        first = self._first.tiles
        points = first.points.copy()
        points[..., :3] = patch.points_m.take(first.index, axis=0)
        points[..., 5:] = patch.normals.take(first.index, axis=0) * self._areas_m2
        centres, facing = self._surface.wrap(pose, self._middles_m)
        return Tiles(
            points=frozen(points),
            taxel=first.taxel,
            index=first.index,
            centres_m=frozen(centres.T.copy()),
            radii_m=self._radii_m,
            facing_m2=frozen(facing * self._areas_m2.sum(axis=1)),
            thickness_m=self._thickness_m,
        )
