"""One press of a ball: the loads of :func:`skincal.model.response.loads` by the shortest way.

A simulation asks for one image at a time, and most of what a batch costs is then the number of its steps. A ball needs
no frame of its own, so there are a third as many. The way is the same: tiles that can be reached before a guessed
limit, distances in closed form, Newton's method on the level, and a second look where the limit was too low.
"""

from __future__ import annotations

import math

import numpy as np

from skincal.model.arrays import FloatArray, as_floats
from skincal.model.contact import Contacts
from skincal.model.indenters.sphere import Sphere
from skincal.model.patch import Patch
from skincal.model.tiles import Tiles

_COARSE = 64
"""Tiles from which the penetration is guessed."""
_AHEAD = 1.2
"""How much deeper than that guess is looked at once."""


def loads_of_one(
    patch: Patch, elasticity_pa_per_m: float, ball: Sphere, contacts: Contacts
) -> FloatArray | None:
    """Loads (1, J) [N] of one press; None unless it is known, presses, and there are points to press on.

    Args:
        patch: the tactile points.
        elasticity_pa_per_m: E [Pa/m].
        ball: what presses.
        contacts: one contact.
    """
    force = float(contacts.force_n[0])
    if not (0 < force < math.inf and len(patch) and contacts.known[0]):
        return None
    normal, tiles = contacts.normals[0], patch.tiles
    up = normal if contacts.rotations is None else contacts.rotations[0, :, 2]
    centre = contacts.indenter_origins_m[0] + ball.radius_m * up
    load = force / elasticity_pa_per_m
    begins, order, near, limit = _reach(tiles, ball.radius_m, centre, normal, load)
    while True:
        some = order[: max(1, int(begins.searchsorted(limit, "right")))]
        points = tiles.points.take(some, axis=0).reshape(-1, 8)
        distance, weight, half = _distances(points, ball.radius_m, centre, normal)
        level = _level(distance, weight, load, near)
        if not level > limit:
            break
        limit = near = level
    if level == math.inf:
        return np.zeros((1, patch.layout.taxels))
    carried = np.maximum(level - distance, 0.0)
    carried *= weight
    carried *= half
    slot = tiles.taxel.take(some, axis=0).ravel() + 1
    sums = as_floats(np.bincount(slot, carried, patch.layout.taxels + 1))
    return (elasticity_pa_per_m / ball.radius_m * sums[1:])[None]


def _reach(
    tiles: Tiles, radius: float, centre: FloatArray, normal: FloatArray, load: float
) -> tuple[FloatArray, np.ndarray[tuple[int, ...], np.dtype[np.intp]], float, float]:
    """Where tiles begin [m], ascending, which these are, a guess of the level and a limit beyond it [m].

    The ball lies behind a paraboloid, -along - R + aside² / 2R; where it can be met, that changes by no more than
    ``steep`` from the middle of a tile to its rim.
    """
    place = tiles.centres_m - centre[:, None]
    along = normal @ place
    place *= place
    middle = place.sum(axis=0)
    middle -= along * along
    middle *= 0.5 / radius
    middle -= along
    middle -= radius
    steep = math.hypot(1.0, 1.0 + float(tiles.radii_m.max()) / radius)
    begins = middle - steep * tiles.radii_m
    order = begins.argsort()
    soon = order[:_COARSE]
    near, first = _guess(middle[soon], np.maximum(tiles.facing_m2[soon] @ normal, 0.0), load)
    return begins[order], order, near, first + _AHEAD * (near - first)


def _guess(distance: FloatArray, weight: FloatArray, load: float) -> tuple[float, float]:
    """The level at which tiles would carry the load if they were points, and the nearest of them [m]."""
    area, moment = weight.cumsum(), (weight * distance).cumsum()
    carries = distance * area - moment < load
    last = len(distance) - 1 - int(carries[::-1].argmax())
    level = (load + float(moment[last])) / float(area[last]) if area[last] > 0 else math.inf
    return level, float(distance.min())


def _distances(
    points: FloatArray, radius: float, centre: FloatArray, normal: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distances (M,) along the normal [m], projected areas [m²] (0 where it misses the ball), half the chords [m]."""
    place = points[:, :3] - centre
    along = place @ normal
    place *= place
    half = along * along
    half -= place @ np.ones(3)
    half += radius * radius
    weight = np.maximum(points[:, 5:] @ normal, 0.0)
    weight[half < 0] = 0.0
    np.sqrt(np.maximum(half, 0.0, out=half), out=half)
    distance = -along
    distance -= half
    return distance, weight, half


def _level(distance: FloatArray, weight: FloatArray, load: float, near: float) -> float:
    """The level at which points carry the load [m]; infinite where none of them can."""
    met = np.where(weight > 0, distance, np.inf)
    first = float(met.min())
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
