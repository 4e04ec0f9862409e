"""Which points of a patch can be touched at all: only those are cast.

Points are taken in compact groups. Each lies within a ball, and within a slab across its normal that is thinner by far:
along the direction of a press it reaches no further than sin(angle) of the one and cos(angle) of the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skincal.model.arrays import BoolArray, FloatArray, IntArray

_POINTS = 16
"""Points in a tile, at most."""
_ROUNDING = 1e-15
"""Squares of sines that differ by less may be the same."""


@dataclass(frozen=True, eq=False)
class Tiles:
    """N points of a patch in B compact groups of M, each within a ball and a slab.

    B * M may be more than N: the rest are copies of points, without an area.

    Attributes:
        points: (B, M, 8) position [m], a one, 1 where the patch ends and 0 elsewhere, and normal times area [m²]:
            all that is needed of a point side by side, so that it is fetched once and moved with one product.
        taxel: (B, M) flat taxel index, -1 for none.
        index: (B, M) index of the point in the patch.
        centres_m: (3, B) centres of the balls [m].
        radii_m: (B,) radii of the balls [m].
        facing_m2: (B, 3) sum of the points' normals times areas [m²].
        thickness_m: (B,) how far points lie from the middle of their ball along :attr:`normals`, at most [m].
    """

    points: FloatArray
    taxel: IntArray
    index: IntArray
    centres_m: FloatArray
    radii_m: FloatArray
    facing_m2: FloatArray
    thickness_m: FloatArray

    @classmethod
    def of(
        cls,
        points_m: FloatArray,
        normals: FloatArray,
        areas_m2: FloatArray,
        taxel: IntArray,
        border: BoolArray,
    ) -> Tiles:
        """Cut points (N, 3) with normals (N, 3), areas, taxels and border (N,) into tiles."""
        slot = _grouped(points_m)
        index = slot % len(points_m)
        ones = np.ones((len(points_m), 1))
        points = np.concatenate(
            [points_m, ones, border[:, None].astype(np.float64), normals * areas_m2[:, None]], axis=1
        )[index]
        points[slot >= len(points_m), 5:] = 0.0
        place = points[..., :3]
        centres = (place.min(axis=1) + place.max(axis=1)) / 2
        away = place - centres[:, None]
        facing = points[..., 5:].sum(axis=1)
        values = (
            points,
            taxel[index],
            index,
            centres.T.copy(),
            np.linalg.norm(away, axis=2).max(axis=1),
            facing,
            np.abs((away @ _unit(facing)[:, :, None])[..., 0]).max(axis=1),
        )
        for value in values:
            value.setflags(write=False)
        return cls(*values)

    @cached_property
    def normals(self) -> FloatArray:
        """(3, B) of the slabs, unit vectors; zero where a group has no area."""
        return _unit(self.facing_m2).T.copy()

    def reach_m(self, directions: FloatArray) -> FloatArray:
        """How far (K, B) points of each group lie from the middle of its ball along unit directions (K, 3), at most.

        None lies further than the ball's radius, whatever the slab. Directions may be a little longer or shorter than
        one, as rotations that were measured or rounded make them.
        """
        across = np.abs(directions @ self.normals)
        length_2 = np.einsum("ki,ki->k", directions, directions)[:, None]
        beside = np.sqrt(np.maximum(length_2 - across * across, _ROUNDING))
        across *= self.thickness_m
        beside *= self.radii_m
        beside += across
        return np.minimum(beside, np.sqrt(length_2) * self.radii_m, out=beside)


def _unit(facing_m2: FloatArray) -> FloatArray:
    """Directions (B, 3) that groups face as a whole; zero where they have no area.

    Args:
        facing_m2: (B, 3) sums of their points' normals times areas [m²].
    """
    length = np.linalg.norm(facing_m2, axis=1, keepdims=True)
    return np.where(length > 0, facing_m2 / np.where(length > 0, length, 1.0), 0.0)


def _grouped(points: FloatArray) -> IntArray:
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
