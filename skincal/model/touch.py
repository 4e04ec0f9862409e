"""From contacts to distances and penetration, at the points that can be touched (paper, section II-A)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from skincal.model.arrays import FloatArray, IntArray
from skincal.model.contact import Contacts
from skincal.model.equilibrium import Settled, settle
from skincal.model.indenters.base import Indenter
from skincal.model.indenters.bound import Bound
from skincal.model.law import StressLaw, settle_under
from skincal.model.tiles import Tiles

COARSE = 32
"""Tiles from which the penetration is guessed; mostly all that are needed, so that the others need no order."""
AHEAD = 1.2
"""How much deeper than that guess is looked at once. A guess that was too low costs a second look, no more."""
FAR_M = 1e3
"""Stands for infinity where it would spoil a sum [m]."""
Kind = TypeVar("Kind", FloatArray, IntArray)


@dataclass(frozen=True, eq=False)
class Touch:
    """Points near K contacts: all that are penetrated, and some that are not.

    Attributes:
        points: (K, M, 8) see :class:`Tiles`; some stand twice, the second time without weight.
        tile: (K, T) the tiles that they are from.
        taxel: (K, M) flat taxel index, -1 for none.
        facing: (K, M) max(-n_s,i . n_c, 0).
        settled: the equilibrium: delta, eps_max, d_i - delta and a_i max(n_t,i . n_c, 0).
    """

    points: FloatArray
    tile: IntArray
    taxel: IntArray
    facing: FloatArray
    settled: Settled


@dataclass(frozen=True, eq=False)
class Pressing:
    """K contacts made ready for casting.

    Attributes:
        normals: (K, 3) contact normals n_c, fingertip frame.
        directions: (K, 3) contact normals, indenter's frame.
        motion: (K, 8, 4) takes a point of :class:`Tiles` to its place in the indenter's frame and its weight.
        bound: the indenter's bound, its own frame.
        tip_bound: the same, fingertip frame.
        load_m3: (K,) F / E [m³], finite and positive.
    """

    normals: FloatArray
    directions: FloatArray
    motion: FloatArray
    bound: Bound
    tip_bound: Bound
    load_m3: FloatArray

    @classmethod
    def of(
        cls,
        contacts: Contacts,
        rows: IntArray,
        indenter: Indenter,
        elasticity_pa_per_m: float,
    ) -> Pressing:
        """Some of the contacts, all of them known and pressing."""
        rotations, origins = (
            contacts.indenter_rotations[rows],
            contacts.indenter_origins_m[rows],
        )
        normals, directions = contacts.normals[rows], contacts.local_directions[rows]
        motion = np.zeros((len(rows), 8, 4))
        motion[:, :3, :3] = rotations
        motion[:, 3, :3] = -(origins[:, None] @ rotations)[:, 0]
        motion[:, 5:, 3] = normals
        bound = indenter.bound(directions, contacts.local_points_m[rows])
        load = contacts.force_n[rows] / elasticity_pa_per_m
        return cls(normals, directions, motion, bound, bound.moved(rotations, origins), load)

    def __getitem__(self, rows: slice) -> Pressing:
        """Some of them."""
        return Pressing(
            self.normals[rows],
            self.directions[rows],
            self.motion[rows],
            self.bound[rows],
            self.tip_bound[rows],
            self.load_m3[rows],
        )


def touch(tiles: Tiles, indenter: Indenter, pressing: Pressing, law: StressLaw | None = None) -> Touch:
    """Find all points that contacts penetrate, and how deep.

    Only what the indenter can reach before a guessed limit is looked at. Points left out can only have carried
    some of the force, so the level found without them is too deep if anything. Where it stays within the limit, no
    point left out is reached at that level, so it is the level of all points, exactly. Where it does not, it is
    itself a limit that is far enough.

    Args:
        tiles: the points of the patch.
        indenter: what presses.
        pressing: K contacts.
        law: how stress grows with penetration; None: in proportion.
    """
    bound = pressing.tip_bound
    place = bound.place(tiles.centres_m)
    begins = bound.distance(place, tiles.radii_m, tiles.reach_m(bound.frame[:, 2]))
    tile, begin = _soonest(begins, COARSE)
    some = _picked(place.reshape(-1, begins.shape[1]), np.repeat(tile, 3, axis=0)).reshape(len(tile), 3, -1)
    near, limit = _guess(tiles, pressing, tile, bound.distance(some))
    while True:
        width = max(1, int((begin <= limit[:, None]).sum(axis=1).max()))
        if width == tile.shape[1] < begins.shape[1]:
            # There may be more of them than were put in order.
            tile, begin = _soonest(begins, begins.shape[1])
            continue
        found = _look(tiles, indenter, pressing, tile[:, :width], limit, near, law)
        level = found.settled.first_m + found.settled.depth_m
        low = level > limit
        if not low.any():
            return found
        limit = np.where(low, level, limit)
        near = level


def _soonest(begins_m: FloatArray, count: int) -> tuple[IntArray, FloatArray]:
    """The tiles (K, T) that can be reached first, as many as asked for or there are, and where (K, T), ascending."""
    if 2 * count >= begins_m.shape[1]:
        order = np.argsort(begins_m, axis=1)[:, :count]
        return order, _picked(begins_m, order)
    some = np.argpartition(begins_m, count, axis=1)[:, :count]
    begin = _picked(begins_m, some)
    order = np.argsort(begin, axis=1)
    return _picked(some, order), _picked(begin, order)


def _picked(values: Kind, which: IntArray) -> Kind:
    """Some of each row (K, N), by their numbers (K, T); as :func:`numpy.take_along_axis`, with less to set up."""
    begin: IntArray = values.shape[1] * np.arange(len(values), dtype=np.int64)
    return values.ravel().take(which + begin[:, None])


def _guess(
    tiles: Tiles, pressing: Pressing, tile: IntArray, distance_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The level if the indenter filled its bound, and a limit that the true one probably does not pass, (K,) [m].

    Args:
        tiles: the points of the patch.
        pressing: K contacts.
        tile: (K, T) the tiles that can be reached first.
        distance_m: (K, T) the bound's distances at their centres, nearly in ascending order [m].
    """
    weight = np.maximum((tiles.facing_m2.take(tile, axis=0) @ pressing.normals[:, :, None])[..., 0], 0.0)
    weight[distance_m == np.inf] = 0.0
    distance = np.minimum(distance_m, FAR_M)
    area, moment = weight.cumsum(axis=1), (weight * distance).cumsum(axis=1)
    carries = distance * area - moment < pressing.load_m3[:, None]
    last = tile.shape[1] - 1 - np.argmax(carries[:, ::-1], axis=1)
    row = np.arange(len(tile))
    area, moment, first = area[row, last], moment[row, last], distance.min(axis=1)
    level = np.divide(pressing.load_m3 + moment, area, out=np.full(len(tile), np.inf), where=area > 0)
    return level, first + AHEAD * (level - first)


def _look(
    tiles: Tiles,
    indenter: Indenter,
    pressing: Pressing,
    tile: IntArray,
    limit_m: FloatArray,
    near_m: FloatArray,
    law: StressLaw | None,
) -> Touch:
    """Cast the points of tiles (K, T) nearer than limits (K,), and find the level at which they carry the force.

    The level is looked for from ``near_m`` (K,) on.
    """
    points = tiles.points.take(tile, axis=0).reshape(len(tile), -1, 8)
    moved = points @ pressing.motion
    weight = np.maximum(moved[..., 3], 0.0)
    distance, facing = indenter.heights(moved[..., :3], pressing.directions, pressing.bound, limit_m)
    taxel = tiles.taxel.take(tile, axis=0).reshape(len(tile), -1)
    settled = settle(distance, weight, pressing.load_m3, near_m)
    if law is not None:
        settled = settle_under(law, settled, pressing.load_m3)
    return Touch(points, tile, taxel, facing, settled)
