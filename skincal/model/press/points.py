"""The points of a patch as the routine takes them: in compact tiles, each within a ball and a slab."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import BoolArray, FloatArray, IntArray

_POINTS = 16
"""Points in a tile, at most."""


@dataclass(frozen=True, eq=False)
class TiledPoints:
    """N points of a patch in B tiles of M neighbours, B M being at least N: the rest are copies without area.

    The arrays are not read-only, as the routine is compiled for arrays that are not; nobody writes to them.

    Attributes:
        points: (6, B M) position [m] and normal times area [m²].
        taxel: (B M,) flat taxel index; -1: none.
        border: (B M,) 1 where the patch ends, 0 elsewhere.
        index: (B M,) index of the point in the patch.
        tiles: (11, B) centre of the ball (3), its radius, sum of the points' normals times areas (3), the same as a
            unit vector (3), and how far points lie from the middle of the ball along it at most [m].
    """

    points: FloatArray
    taxel: IntArray
    border: FloatArray
    index: IntArray
    tiles: FloatArray

    @classmethod
    def of(
        cls,
        points_m: FloatArray,
        normals: FloatArray,
        areas_m2: FloatArray,
        taxel: IntArray,
        border: BoolArray,
    ) -> TiledPoints:
        """Cut points (N, 3) with normals (N, 3), areas, taxels and border (N,) into tiles."""
        slots = grouped(points_m) if len(points_m) else np.zeros((0, 1), dtype=np.int64)
        index = slots % max(len(points_m), 1)
        of_point = taxel[index.ravel()].astype(np.int64), border[index.ravel()].astype(np.float64)
        return cls.at(points_m, normals, areas_m2, slots, *of_point)

    @classmethod
    def at(
        cls,
        points_m: FloatArray,
        normals: FloatArray,
        areas_m2: FloatArray,
        slots: IntArray,
        taxel: IntArray,
        border: FloatArray,
    ) -> TiledPoints:
        """Points in tiles that are known: slot (B, M) s holds point s mod N, without its area where s >= N."""
        count = len(points_m)
        index = slots.ravel() % max(count, 1)
        points = np.empty((6, index.size))
        points[:3] = points_m[index].T
        points[3:] = (normals * areas_m2[:, None])[index].T
        points[3:, slots.ravel() >= count] = 0.0
        shape = (len(slots), -1)
        place = points[:3].reshape(3, *shape) if index.size else points[:3].reshape(3, 0, 1)
        tiles = np.empty((11, len(slots)))
        if index.size:
            middle = (place.min(axis=2) + place.max(axis=2)) / 2
            away = place - middle[:, :, None]
            facing = points[3:].reshape(3, *shape).sum(axis=2)
            length = np.sqrt((facing * facing).sum(axis=0))
            unit = np.divide(facing, length, out=np.zeros_like(facing), where=length > 0)
            tiles[:3], tiles[3] = middle, np.sqrt((away * away).sum(axis=0)).max(axis=1)
            tiles[4:7], tiles[7:10] = facing, unit
            tiles[10] = np.abs((away * unit[:, :, None]).sum(axis=0)).max(axis=1)
        return cls(points, taxel, border, index, tiles)


def grouped(points: FloatArray) -> IntArray:
    """Slots (B, M) in groups of neighbours, B a power of two; slot s holds point s mod N.

    All groups are halved across their longest side at once, again and again.
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
