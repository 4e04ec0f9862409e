"""Where points meet an indenter: the closed forms, tile by tile, and what bounds them.

A new closed form is one file with the functions ``meet`` and ``paraboloid`` (see
:mod:`skincal.model.indenters.sphere`), a number here and a branch in each of the two functions below.
"""

from __future__ import annotations

import math

from skincal.model.arrays import FloatArray
from skincal.model.indenters import flat, sphere
from skincal.model.press.jit import device

SPHERE, FLAT = sphere.Sphere.kind, flat.FlatPunch.kind

_meet_sphere, _meet_flat = device(sphere.meet), device(flat.meet)
_around_sphere, _around_flat = device(sphere.paraboloid), device(flat.paraboloid)

Frame = tuple[float, ...]
"""Contact normal and the three axes of the indenter's frame, fingertip frame: 12 numbers."""


@device
def meet(
    kind: int, size: float, frame: Frame, place: FloatArray, count: int, gap: FloatArray, facing: FloatArray
) -> None:
    """Distances [m] and facing of points, into ``gap`` and ``facing``.

    Args:
        kind: of closed form.
        size: of the indenter [m].
        frame: contact normal and the axes of the indenter's frame.
        place: (3, count) points from the origin of the indenter's frame, fingertip frame [m].
        count: number of points.
        gap: filled; inf where the indenter is missed.
        facing: filled with max(-n_s . n_c, 0).
    """
    if kind == SPHERE:
        for i in range(count):
            gap[i], facing[i] = _meet_sphere(size, frame, place[0, i], place[1, i], place[2, i])
    else:
        for i in range(count):
            gap[i], facing[i] = _meet_flat(size, frame, place[0, i], place[1, i], place[2, i])


@device
def paraboloid(kind: int, size: float, frame: Frame) -> tuple[float, float, float, float, float, float]:
    """What the indenter lies behind: a point of its axis from the origin (3), ``nearest``, ``bend`` and ``reach``.

    No point of the indenter that lies by r beside the axis, which runs along the contact normal, is nearer along it
    than ``nearest`` + ``bend`` r², and none lies beside it by more than ``reach`` [m, 1/m, m].
    """
    if kind == SPHERE:
        return _around_sphere(size, frame)
    return _around_flat(size, frame)


@device
def bound_tiles(
    tiles: FloatArray,
    normal: tuple[float, float, float],
    axis: tuple[float, float, float],
    nearest: float,
    bend: float,
    reach: float,
    begin: FloatArray,
    middle: FloatArray,
    weight: FloatArray,
) -> None:
    """Distances before which no point of a tile meets a paraboloid, those at the tiles' middles, and areas along n_c.

    Args:
        tiles: see :class:`skincal.model.tiles.Tiles`.
        normal: contact normal.
        axis: a point of the paraboloid's axis [m].
        nearest: see :func:`paraboloid`.
        bend: the same.
        reach: the same.
        begin: (B,) filled; inf where it is not met at all.
        middle: (B,) filled; ``FAR`` where it is not met.
        weight: (B,) filled; 0 where it is not met.
    """
    nx, ny, nz = normal
    cx, cy, cz = axis
    for b in range(tiles.shape[1]):
        x = tiles[0, b] - cx
        y = tiles[1, b] - cy
        z = tiles[2, b] - cz
        along = x * nx + y * ny + z * nz
        aside = math.sqrt(max(x * x + y * y + z * z - along * along, 0.0))
        radius = tiles[3, b]
        across = abs(tiles[7, b] * nx + tiles[8, b] * ny + tiles[9, b] * nz)
        slab = across * tiles[10, b] + math.sqrt(max(1.0 - across * across, ROUNDING)) * radius
        near = max(aside - radius, 0.0)
        begin[b] = nearest - along - min(slab, radius) + bend * near * near if near <= reach else math.inf
        area = tiles[4, b] * nx + tiles[5, b] * ny + tiles[6, b] * nz
        met = aside <= reach and area > 0
        middle[b] = nearest - along + bend * aside * aside if met else FAR
        weight[b] = area if met else 0.0


FAR = 1e3
"""Stands for infinity where that would spoil a sum [m]."""
ROUNDING = 1e-15
"""Squares of sines that differ by less may be the same."""
