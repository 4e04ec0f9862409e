"""One press: the loads of :func:`skincal.model.response.loads` by the shortest way.

A simulation asks for one image at a time, and most of what a batch costs is then the number of its steps. The way is
the same: tiles that can be reached before a guessed limit, distances of their points, Newton's method on the level, and
a second look where the limit was too low.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from skincal.model.arrays import FloatArray, IntArray, as_floats
from skincal.model.contact import Contacts
from skincal.model.indenters.base import ClosedForm, Indenter
from skincal.model.patch import Patch
from skincal.model.tiles import Tiles
from skincal.model.touch import AHEAD, FAR_M

COARSE = 64
"""Tiles from which the level is guessed. More than in a batch: their balls alone bound them, which is less to do."""


class OnePress(Protocol):
    """An indenter at its place, looked at along the contact normal.

    Attributes:
        normal: (3,) contact normal n_c, fingertip frame.
    """

    normal: FloatArray

    def place(self, tiles: Tiles) -> FloatArray:
        """Where tiles are, as the other methods take it (..., B)."""
        ...

    def begins(self, place: FloatArray, tiles: Tiles) -> FloatArray:
        """Distances (B,) before which no point of a tile is met [m]."""
        ...

    def middles(self, place: FloatArray) -> FloatArray:
        """Distances at the middles of tiles [m], of the indenter or of what encloses it."""
        ...

    def points(
        self, points: FloatArray, limit_m: float
    ) -> tuple[slice | IntArray, FloatArray, FloatArray, FloatArray]:
        """What is met nearer than a limit.

        Args:
            points: (M, 8) as of :class:`Tiles`.
            limit_m: distances that matter; greater ones may be left out [m].

        Returns:
            Which of the points, and of these: finite distances [m], areas along the normal [m²], 0 where nothing is
            met, and how far the surface met faces against the normal.
        """
        ...


def loads_of_one(
    patch: Patch, elasticity_pa_per_m: float, indenter: Indenter, contacts: Contacts
) -> FloatArray | None:
    """Loads (1, J) [N] of one press; None unless it is known, presses, and there are points to press on.

    Args:
        patch: the tactile points.
        elasticity_pa_per_m: E [Pa/m].
        indenter: what presses.
        contacts: one contact.
    """
    if isinstance(indenter, ClosedForm):
        return None
    force = float(contacts.force_n[0])
    if not (0 < force < math.inf and len(patch) and contacts.known[0]):
        return None
    press: OnePress = _Cast(indenter, contacts)
    load, tiles, taxels = force / elasticity_pa_per_m, patch.tiles, patch.layout.taxels
    begins, near, limit = _reach(press, tiles, load)
    while True:
        some = np.flatnonzero(begins <= limit)
        points = tiles.points.take(some, axis=0).reshape(-1, 8)
        which, distance, weight, facing = press.points(points, limit)
        level = _level(distance, weight, load, near)
        if not level > limit:
            break
        limit = near = level
    if level == math.inf:
        return np.zeros((1, taxels))
    carried = np.maximum(level - distance, 0.0)
    carried *= weight
    carried *= facing
    slot = tiles.taxel.take(some, axis=0).ravel()[which] + 1
    sums = as_floats(np.bincount(slot, carried, taxels + 1))
    return (elasticity_pa_per_m * sums[1:])[None]


def _reach(press: OnePress, tiles: Tiles, load: float) -> tuple[FloatArray, float, float]:
    """Where tiles begin (B,), a guess of the level and a limit beyond it [m]."""
    place = press.place(tiles)
    begins = press.begins(place, tiles)
    soon = np.arange(len(begins))
    if len(begins) > COARSE:
        soon = begins.argpartition(COARSE)[:COARSE]
    soon = soon[begins[soon].argsort()]
    distance = press.middles(place[..., soon])
    weight = np.maximum(tiles.facing_m2[soon] @ press.normal, 0.0)
    weight[distance == math.inf] = 0.0
    near, first = _guess(np.minimum(distance, FAR_M), weight, load)
    # Never before the tile that begins first: there must be something to look at.
    return begins, near, max(first + AHEAD * (near - first), float(begins[soon[0]]))


def _guess(distance: FloatArray, weight: FloatArray, load: float) -> tuple[float, float]:
    """The level at which tiles would carry the load if they were points, and the nearest of them [m]."""
    area, moment = weight.cumsum(), (weight * distance).cumsum()
    carries = distance * area - moment < load
    last = len(distance) - 1 - int(carries[::-1].argmax())
    level = (load + float(moment[last])) / float(area[last]) if area[last] > 0 else math.inf
    return level, float(distance.min())


def _level(distance: FloatArray, weight: FloatArray, load: float, near: float) -> float:
    """The level at which points carry the load [m]; infinite where none of them can."""
    met = np.where(weight > 0, distance, np.inf)
    first = float(met.min(initial=math.inf))
    if first == math.inf:
        return math.inf
    level, begun = max(near, first), False
    while True:
        carries = weight * (met <= level)
        lower = (load + float(carries @ distance)) / float(carries.sum())
        # The first step leads to the level or above it, from wherever it starts.
        if begun and not lower < level:
            return level
        level, begun = lower, True


class _Cast:
    """Anything else: rays at what its bound does not rule out."""

    def __init__(self, indenter: Indenter, contacts: Contacts) -> None:
        self.normal: FloatArray = contacts.normals[0]
        rotations, origins = contacts.indenter_rotations, contacts.indenter_origins_m
        directions = contacts.local_directions
        self._indenter, self._direction = indenter, directions[0]
        self._rotation, self._origin = rotations[0], origins[0]
        self._tip_bound = indenter.bound(directions, contacts.local_points_m).moved(rotations, origins)

    def place(self, tiles: Tiles) -> FloatArray:
        """Coordinates (1, 3, B) about the bound's axis [m]."""
        return self._tip_bound.place(tiles.centres_m)

    def begins(self, place: FloatArray, tiles: Tiles) -> FloatArray:
        """See :meth:`OnePress.begins`."""
        return self._tip_bound.distance(place, tiles.radii_m)[0]

    def middles(self, place: FloatArray) -> FloatArray:
        """See :meth:`OnePress.middles`."""
        return self._tip_bound.distance(place)[0]

    def points(
        self, points: FloatArray, limit_m: float
    ) -> tuple[slice | IntArray, FloatArray, FloatArray, FloatArray]:
        """See :meth:`OnePress.points`."""
        places = self._tip_bound.place(points[:, :3].T)
        near: IntArray = np.flatnonzero(self._tip_bound.distance(places)[0] <= limit_m)
        some = points[near]
        if not len(near):
            # Tiles begin before their points do.
            nothing = np.zeros(0)
            return near, nothing, nothing, nothing
        origins = (some[:, :3] - self._origin) @ self._rotation
        distance, facing = self._indenter.along(origins, self._direction)
        weight = np.maximum(some[:, 5:] @ self.normal, 0.0)
        missed = distance == math.inf
        weight[missed] = distance[missed] = 0.0
        return near, distance, weight, facing
