"""The points of a patch in compact tiles for the compiled routine, each bounded by a ball and a slab."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skincal.model.arrays import BoolArray, FloatArray, IntArray

_POINTS = 16
"""Largest number of points in a tile."""


@dataclass(frozen=True, eq=False)
class TiledPoints:
    """N points of a patch in B tiles of M neighbours; the B M - N surplus slots hold copies without area.

    The arrays are writable because the routine is compiled for writable arrays; nothing writes to them.

    Attributes:
        points: (6, B M) position [m] and normal times area [m²].
        tiles: (11, B) centre of the bounding ball (3) [m], its radius [m], sum of the points' normals times areas (3)
            [m²], its direction as a unit vector (3), and half the thickness of the slab: the largest distance of a
            point from the centre along that direction [m].
        taxel: (B M,) flat taxel index; -1: none.
        border: (B M,) 1 at the edge of the patch, else 0.
        index: (B M,) index of the point in the patch.
        slots: (B, M) slot s holds point s mod N, without area where s >= N.
    """

    points: FloatArray
    tiles: FloatArray
    taxel: IntArray
    border: FloatArray
    index: IntArray
    slots: IntArray

    @classmethod
    def of(
        cls,
        points_m: FloatArray,
        normals: FloatArray,
        areas_m2: FloatArray,
        taxel: IntArray,
        border: BoolArray,
    ) -> TiledPoints:
        """Group points (N, 3) with normals (N, 3), areas, taxels and border flags (N,) into tiles."""
        slots = group_neighbours(points_m) if len(points_m) else np.zeros((0, 1), dtype=np.int64)
        index = slots.ravel() % max(len(points_m), 1)
        fixed = taxel[index].astype(np.int64), border[index].astype(np.float64), index, slots
        return cls(*_placed(points_m, normals, areas_m2, slots), *fixed)

    def moved(self, points_m: FloatArray, normals: FloatArray, areas_m2: FloatArray) -> TiledPoints:
        """Return the same tiles with their points (N, 3) at new positions."""
        points, tiles = _placed(points_m, normals, areas_m2, self.slots)
        return replace(self, points=points, tiles=tiles)


def _placed(
    points_m: FloatArray, normals: FloatArray, areas_m2: FloatArray, slots: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return ``points`` and ``tiles`` of :class:`TiledPoints` for slots (B, M)."""
    count = len(points_m)
    index = slots.ravel() % max(count, 1)
    points, tiles = np.empty((6, index.size)), np.empty((11, len(slots)))
    if not index.size:
        return points, tiles
    points[:3] = points_m.T.take(index, axis=1)
    points[3:] = (normals.T * areas_m2).take(index, axis=1)
    points[3:, slots.ravel() >= count] = 0.0
    place = points.reshape(6, len(slots), -1)
    middle = (place[:3].min(axis=2) + place[:3].max(axis=2)) / 2
    away = place[:3] - middle[:, :, None]
    facing = place[3:].sum(axis=2)
    length = np.sqrt((facing * facing).sum(axis=0))
    unit = facing / np.where(length > 0, length, 1.0)
    tiles[:3], tiles[3] = middle, np.sqrt((away * away).sum(axis=0)).max(axis=1)
    tiles[4:7], tiles[7:10] = facing, unit
    tiles[10] = np.abs((away * unit[:, :, None]).sum(axis=0)).max(axis=1)
    return points, tiles


def group_neighbours(points: FloatArray) -> IntArray:
    """Group points (N, 3) into tiles of neighbours: slots (B, M), B a power of two; slot s holds point s mod N.

    All groups are repeatedly halved across their longest side.
    """
    groups = 1
    while groups * _POINTS < len(points):
        groups *= 2
    slots = np.arange(groups * -(-len(points) // groups)).reshape(1, -1)
    while len(slots) < groups:
        places = points[slots % len(points)]
        longest = np.argmax(np.ptp(places, axis=1), axis=1)
        along = np.take_along_axis(places, longest[:, None, None], axis=2)[..., 0]
        slots = np.take_along_axis(slots, np.argsort(along, axis=1, kind="stable"), axis=1)
        slots = slots.reshape(2 * len(slots), -1)
    return slots
