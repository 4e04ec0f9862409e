"""Distances from points to closed-form indenters, and their bounds for tiles of points.

A new closed form needs one file with the functions ``meet`` and ``paraboloid`` (see
:mod:`skincal.model.indenters.sphere`), and a branch in :func:`meet_point` and :func:`paraboloid`.
"""

from __future__ import annotations

import math

from skincal.model.arrays import FloatArray
from skincal.model.indenters import flat, sphere
from skincal.model.indenters.indenter import MISSED
from skincal.model.press.jit import device

SPHERE, FLAT = sphere.Sphere.kind, flat.FlatPunch.kind

_meet_sphere, _meet_flat = device(sphere.meet), device(flat.meet)
_around_sphere, _around_flat = device(sphere.paraboloid), device(flat.paraboloid)

Frame = tuple[float, ...]
"""Contact normal and the three axes of the indenter's frame, in the fingertip frame: 12 numbers."""


@device
def meet_point(kind: int, size: float, frame: Frame, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the distance [m] and facing of a point: see :func:`skincal.model.indenters.sphere.meet`."""
    if kind == SPHERE:
        return _meet_sphere(size, frame, x, y, z)
    return _meet_flat(size, frame, x, y, z)


@device
def meet(
    kind: int, size: float, frame: Frame, place: FloatArray, count: int, gap: FloatArray, facing: FloatArray
) -> None:
    """Fill in distances [m] and facing of points (3, count): see :func:`meet_point`."""
    for i in range(count):
        gap[i], facing[i] = meet_point(kind, size, frame, place[0, i], place[1, i], place[2, i])


def cast(
    kind: int, size: float, direction: FloatArray, points: FloatArray, gap: FloatArray, facing: FloatArray
) -> None:
    """Fill in distances [m] and facing of points (3, N) along a direction (3,), all in the indenter's frame."""
    x, y, z = direction[0], direction[1], direction[2]
    frame = (x, y, z, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    meet(kind, size, frame, points, points.shape[1], gap, facing)
    for i in range(points.shape[1]):
        facing[i] = facing[i] if gap[i] < MISSED else 0.0


@device
def paraboloid(kind: int, size: float, frame: Frame) -> tuple[float, float, float, float, float, float]:
    """Return a paraboloid that bounds the indenter: a point on its axis (3), ``nearest``, ``bend`` and ``reach``.

    The axis runs along the contact normal; its point is relative to the origin of the indenter's frame [m]. A point of
    the indenter at a distance r from the axis lies at least ``nearest`` + ``bend`` r² along the normal, and r is at
    most ``reach`` [m, 1/m, m].
    """
    if kind == SPHERE:
        return _around_sphere(size, frame)
    return _around_flat(size, frame)


@device
def bound_tile(
    tiles: FloatArray, b: int, normal: tuple[float, float, float], axis: tuple[float, float, float],
    nearest: float, bend: float, reach: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Bound the distance between a tile and a paraboloid.

    Args:
        tiles: (11, B) see :class:`skincal.model.press.points.TiledPoints`.
        b: index of the tile.
        normal: contact normal.
        axis: a point on the paraboloid's axis [m].
        nearest: see :func:`paraboloid`.
        bend: the same.
        reach: the same.

    Returns:
        Lower bound of the distance over all points of the tile [m], inf if the tile misses; distance at the middle of
        the tile [m] and area along the normal [m²], ``FAR`` and 0 if the middle misses.
    """
    nx, ny, nz = normal
    x = tiles[0, b] - axis[0]
    y = tiles[1, b] - axis[1]
    z = tiles[2, b] - axis[2]
    along = x * nx + y * ny + z * nz
    aside = math.sqrt(max(x * x + y * y + z * z - along * along, 0.0))
    radius = tiles[3, b]
    across = abs(tiles[7, b] * nx + tiles[8, b] * ny + tiles[9, b] * nz)
    slab = across * tiles[10, b] + math.sqrt(max(1.0 - across * across, ROUNDING)) * radius
    near = max(aside - radius, 0.0)
    begin = nearest - along - min(slab, radius) + bend * near * near if near <= reach else MISSED
    area = tiles[4, b] * nx + tiles[5, b] * ny + tiles[6, b] * nz
    met = aside <= reach and area > 0
    return begin, nearest - along + bend * aside * aside if met else FAR, area if met else 0.0


FAR = 1e3
"""Stands for infinity where infinity would make a sum NaN [m]."""
ROUNDING = 1e-15
"""Rounding error of the square of a sine."""
