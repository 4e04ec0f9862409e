"""Presses of meshes: which points are worth a ray, and what the rays say. Between the two embree is asked.

A mesh lies behind paraboloids, one for each of its connected parts. They never change a result: a point that no
paraboloid puts nearer than the limit is not nearer.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from skincal.model.arrays import BoolArray, FloatArray, IntArray
from skincal.model.press.jit import device
from skincal.model.press.meet import FAR, ROUNDING, Frame
from skincal.model.press.routine import Ground, Told, carry, frame_of, guess, largest, room_for, untouched

BOUND = 13
"""Numbers of a paraboloid: a point of its axis (3), a side (3), ``slope``, ``nearest``, three ``bend``, two ``reach``.

Seen along the direction, at s along the side, w across it and r beside the axis, no point of the part is nearer than
``nearest`` + ``slope`` s + max(bend_0 r², bend_1 s², bend_2 w²), and none has r or \\|s\\| greater than its ``reach``.
"""
_WIDER = 1.0 + 1e-9
"""Rounding must not leave out a point at the very rim."""
_SLACKS_M = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
"""How far before the nearest vertex a paraboloid may start: the further, the more it may bend."""
_DEPTH_M, _FLAT = 2e-4, 20.0
"""A usual penetration [m] and a curvature of the skin over two [1/m]: of the ways to bend, the best for these."""
_LEAST_ACROSS = 0.1
"""Seen more along its long axis than this (sine), a part has no slope."""


@device
def _across(
    x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[float, float, float, float]:
    """The part of a vector across a unit vector, as a unit vector, and its length."""
    along = x * dx + y * dy + z * dz
    x -= along * dx
    y -= along * dy
    z -= along * dz
    length = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / max(length, 1e-12)
    return x * scale, y * scale, z * scale, length


@device
def local(frame: Frame, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector of the fingertip frame in the indenter's."""
    return (
        x * frame[3] + y * frame[4] + z * frame[5],
        x * frame[6] + y * frame[7] + z * frame[8],
        x * frame[9] + y * frame[10] + z * frame[11],
    )


@device
def outside(frame: Frame, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector of the indenter's frame in the fingertip's."""
    return (
        x * frame[3] + y * frame[6] + z * frame[9],
        x * frame[4] + y * frame[7] + z * frame[10],
        x * frame[5] + y * frame[8] + z * frame[11],
    )


def enclose(
    vertices: FloatArray, parts: IntArray, axes: FloatArray, middles: FloatArray, rows: FloatArray,
    turned: bool, at: IntArray, bounds: FloatArray,
) -> None:  # fmt: skip
    """Paraboloids behind which the parts of a mesh lie, in its own frame.

    What lies behind a paraboloid is a convex set: where all vertices are in it, so are the faces. Of those about the
    part's middle and about the contact, that start a little before the nearest vertex, the one is taken that leaves
    the fewest points.

    Args:
        vertices: (V, 3) of convex hulls, part by part [m].
        parts: (Q + 1,) where each part begins.
        axes: (Q, 4) long axis of each part, and 1 if it is much longer than wide.
        middles: (Q, 3) middle of each part [m].
        rows: see :func:`skincal.model.press.routine.press`.
        turned: the same.
        at: (P,) rows of places.
        bounds: (P, Q, 13) filled: see :data:`BOUND`.
    """
    most = 0
    for q in range(parts.shape[0] - 1):
        most = max(most, parts[q + 1] - parts[q])
    height, along_2, aside_2 = np.empty(most), np.empty(most), np.empty(most)
    for k in range(at.shape[0]):
        row = rows[at[k]]
        frame = frame_of(row, turned)
        dx, dy, dz = local(frame, frame[0], frame[1], frame[2])
        tx, ty, tz = local(frame, row[15] - row[3], row[16] - row[4], row[17] - row[5])
        for q in range(parts.shape[0] - 1):
            sx, sy, sz, across = _across(axes[q, 0], axes[q, 1], axes[q, 2], dx, dy, dz)
            slope = 0.0
            if across < 1e-6:
                sx, sy, sz, across = _across(1.0 - abs(dx), 1.0 - abs(dy), 1.0 - abs(dz), dx, dy, dz)
            elif axes[q, 3] > 0 and across > _LEAST_ACROSS:
                slope = (axes[q, 0] * dx + axes[q, 1] * dy + axes[q, 2] * dz) / across
            best = math.inf
            for about in range(2):
                cx, cy, cz = tx, ty, tz
                if about == 0:
                    cx, cy, cz = middles[q, 0], middles[q, 1], middles[q, 2]
                first, count = parts[q], parts[q + 1] - parts[q]
                nearest, furthest_s, furthest_r = math.inf, 0.0, 0.0
                for i in range(count):
                    x = vertices[first + i, 0] - cx
                    y = vertices[first + i, 1] - cy
                    z = vertices[first + i, 2] - cz
                    ahead = x * dx + y * dy + z * dz
                    beside = x * sx + y * sy + z * sz
                    height[i] = ahead - slope * beside
                    along_2[i] = beside * beside
                    aside_2[i] = max(x * x + y * y + z * z - ahead * ahead, 0.0)
                    nearest = min(nearest, height[i])
                    furthest_s, furthest_r = max(furthest_s, along_2[i]), max(furthest_r, aside_2[i])
                for slack in _SLACKS_M:
                    round_, along, wide = math.inf, math.inf, math.inf
                    for i in range(count):
                        rise = height[i] - nearest + slack
                        round_ = min(round_, rise / max(aside_2[i], 1e-30))
                        along = min(along, rise / max(along_2[i], 1e-30))
                        wide = min(wide, rise / max(aside_2[i] - along_2[i], 1e-30))
                    narrow = math.sqrt((max(along, round_) + _FLAT) * (max(wide, round_) + _FLAT))
                    score = (_DEPTH_M + slack) / narrow
                    if score < best:
                        best = score
                        b = bounds[k, q]
                        b[0], b[1], b[2], b[3], b[4], b[5] = cx, cy, cz, sx, sy, sz
                        b[6], b[7], b[8], b[9], b[10] = slope, nearest - slack, round_, along, wide
                        b[11], b[12] = math.sqrt(furthest_r) * _WIDER, math.sqrt(furthest_s) * _WIDER


@device
def bound_tiles_by_part(
    tiles: FloatArray, frame: Frame, origin: tuple[float, float, float], bound: FloatArray,
    begin: FloatArray, near: FloatArray,
) -> None:  # fmt: skip
    """Lower ``begin`` and ``near`` (B,) to those of one part: see :func:`skincal.model.press.meet.bound_tile`."""
    nx, ny, nz = frame[0], frame[1], frame[2]
    sx, sy, sz = bound[3], bound[4], bound[5]
    slope, nearest, round_, along_, wide_ = bound[6], bound[7], bound[8], bound[9], bound[10]
    reach, reach_side = bound[11], bound[12]
    ox, oy, oz = origin[0] + bound[0], origin[1] + bound[1], origin[2] + bound[2]
    for b in range(tiles.shape[1]):
        x, y, z, radius = tiles[0, b] - ox, tiles[1, b] - oy, tiles[2, b] - oz, tiles[3, b]
        along = x * nx + y * ny + z * nz
        side = abs(x * sx + y * sy + z * sz)
        aside_2 = max(x * x + y * y + z * z - along * along, 0.0)
        wide_2 = max(aside_2 - side * side, 0.0)
        aside, wide = math.sqrt(aside_2), math.sqrt(wide_2)
        level = nearest - along + slope * (x * sx + y * sy + z * sz)
        centre = level + max(round_ * aside_2, max(along_ * side * side, wide_ * wide_2))
        near[b] = min(near[b], centre if aside <= reach and side <= reach_side else FAR)
        across = abs(tiles[7, b] * nx + tiles[8, b] * ny + tiles[9, b] * nz)
        slab = across * tiles[10, b] + math.sqrt(max(1.0 - across * across, ROUNDING)) * radius
        aside, side, wide = max(aside - radius, 0.0), max(side - radius, 0.0), max(wide - radius, 0.0)
        bent = max(round_ * aside * aside, max(along_ * side * side, wide_ * wide * wide))
        ball = level - min(slab, radius) - radius * abs(slope) + bent
        begin[b] = min(begin[b], ball if aside <= reach and side <= reach_side else math.inf)


@device
def first_met(bound: FloatArray, frame: Frame, x: float, y: float, z: float) -> float:
    """The distance before which a point, from the origin of the indenter's frame, does not meet a part [m]."""
    x -= bound[0]
    y -= bound[1]
    z -= bound[2]
    along = x * frame[0] + y * frame[1] + z * frame[2]
    side = x * bound[3] + y * bound[4] + z * bound[5]
    side_2 = side * side
    aside_2 = max(x * x + y * y + z * z - along * along, 0.0)
    bent = max(bound[8] * aside_2, max(bound[9] * side_2, bound[10] * (aside_2 - side_2)))
    met = aside_2 <= bound[11] * bound[11] and side_2 <= bound[12] * bound[12]
    return bound[7] - along + bound[6] * side + bent if met else math.inf


def select(  # noqa: D417
    points: FloatArray, tiles: FloatArray, rows: FloatArray, turned: bool, force: FloatArray,
    elasticity: float, exponent: float, reference: float, info: FloatArray, starts: IntArray,
    at: IntArray, bounds: FloatArray, limits: FloatArray, guesses: FloatArray, ahead: float,
    asked: BoolArray, middle: FloatArray, back: float, scale: float, begins: IntArray,
) -> tuple[IntArray, NDArray[np.float32], NDArray[np.float32]]:  # fmt: skip
    """The points that may be nearer than a limit, and their rays as embree takes them.

    What is not told of here is as in :func:`skincal.model.press.routine.press`.

    Args:
        starts: (P + 1,) see :func:`skincal.model.press.routine.group`.
        at: (P,) the same.
        bounds: (P or 1, Q, 13) of :func:`enclose`.
        limits: (P,) limits to look at [m]; where minus infinity filled with a guess.
        guesses: (2, P) filled where a limit is guessed: the level if the mesh filled its bound, and where that begins.
        ahead: how much deeper than that level is looked at.
        asked: (P,) which places are meant.
        middle: (3,) middle of the mesh, its own frame [m].
        back: how far before the middle rays start [m].
        scale: of embree's scene.
        begins: (P + 1,) filled: where each place begins in the results.

    Returns:
        Numbers of the points (n,), starts (n, 3) and directions (n, 3) of their rays, scaled, single precision.
    """
    count_tiles, parts = tiles.shape[1], bounds.shape[1]
    each = points.shape[1] // count_tiles
    begin, near, area = np.empty(count_tiles), np.empty(count_tiles), np.empty(count_tiles)
    coarse, bound = np.empty((2, count_tiles)), np.empty((parts, BOUND))
    room = 512 * at.shape[0]
    which = np.empty(room, np.int64)
    rays, ways = np.empty((room, 3), np.float32), np.empty((room, 3), np.float32)
    n = 0
    for p in range(at.shape[0]):
        begins[p] = n
        if not asked[p]:
            continue
        row = rows[at[p]]
        frame = frame_of(row, turned)
        ox, oy, oz = row[3], row[4], row[5]
        for b in range(count_tiles):
            begin[b], near[b] = math.inf, FAR
        for q in range(parts):
            own = bounds[p if bounds.shape[0] > 1 else 0, q]
            bound[q, 0], bound[q, 1], bound[q, 2] = outside(frame, own[0], own[1], own[2])
            bound[q, 3], bound[q, 4], bound[q, 5] = outside(frame, own[3], own[4], own[5])
            for i in range(6, BOUND):
                bound[q, i] = own[i]
            bound_tiles_by_part(tiles, frame, (ox, oy, oz), bound[q], begin, near)
        for b in range(count_tiles):
            facing = tiles[4, b] * frame[0] + tiles[5, b] * frame[1] + tiles[6, b] * frame[2]
            met = facing > 0 and near[b] < FAR
            area[b] = facing if met else 0.0
            near[b] = near[b] if met else FAR
        if limits[p] < -FAR:
            most = largest(force, info, starts[p], starts[p + 1]) / elasticity
            level, first = guess(near, area, coarse[0], coarse[1], most, _FLAT, exponent, reference)
            limits[p] = first + ahead * (level - first) if level < math.inf else math.inf
            guesses[0, p], guesses[1, p] = level, first
        mx, my, mz = outside(frame, middle[0], middle[1], middle[2])
        wx, wy, wz = local(frame, frame[0], frame[1], frame[2])
        for b in range(count_tiles):
            if begin[b] > limits[p] or begin[b] == math.inf:
                continue
            if n + each > room:
                room = 2 * room + each
                more = np.empty(room, np.int64)
                more_rays, more_ways = np.empty((room, 3), np.float32), np.empty((room, 3), np.float32)
                # Loops, as numba takes seconds to compile the assignment of slices.
                for i in range(n):
                    more[i] = which[i]
                    for c in range(3):
                        more_rays[i, c], more_ways[i, c] = rays[i, c], ways[i, c]
                which, rays, ways = more, more_rays, more_ways
            for k in range(b * each, b * each + each):
                x, y, z = points[0, k] - ox, points[1, k] - oy, points[2, k] - oz
                soonest = math.inf
                for q in range(parts):
                    soonest = min(soonest, first_met(bound[q], frame, x, y, z))
                carries = points[3, k] * frame[0] + points[4, k] * frame[1] + points[5, k] * frame[2]
                if soonest > limits[p] or soonest == math.inf or carries <= 0:
                    continue
                which[n] = k
                x, y, z = x - mx, y - my, z - mz
                shift = x * frame[0] + y * frame[1] + z * frame[2] + back
                a, b_, c_ = local(frame, x - shift * frame[0], y - shift * frame[1], z - shift * frame[2])
                rays[n, 0], rays[n, 1], rays[n, 2] = a * scale, b_ * scale, c_ * scale
                ways[n, 0], ways[n, 1], ways[n, 2] = wx, wy, wz
                n += 1
    begins[at.shape[0]] = n
    return which[:n], rays[:n], ways[:n]


def press_cast(  # noqa: D417
    points: FloatArray, taxel: IntArray, border: FloatArray, through: float, rows: FloatArray,
    turned: bool, force: FloatArray, elasticity: float, exponent: float, reference: float,
    loads: FloatArray, info: FloatArray, entry: IntArray, entries: IntArray, entry_loads: FloatArray,
    starts: IntArray, at: IntArray, cast: IntArray, begins: IntArray, face: NDArray[np.int32],
    normals: FloatArray, heights: FloatArray, middle: FloatArray, limits: FloatArray, again: BoolArray,
) -> None:  # fmt: skip
    """Settle presses of a mesh, once embree has said which triangle each point meets.

    What is not told of here is as in :func:`skincal.model.press.routine.press`.

    Args:
        starts: (P + 1,) see :func:`skincal.model.press.routine.group`.
        at: (P,) the same.
        cast: (n,) points that were cast, place by place, see :func:`select`.
        begins: (P + 1,) where each place begins in them.
        face: (n,) the triangle that is met; -1: none.
        normals: (F, 3) of the triangles.
        heights: (F,) of their planes above the mesh's origin [m].
        middle: (3,) middle of the mesh, its own frame [m].
        limits: (P,) as looked at; filled with the levels that were found, to look as far if that was not enough [m].
        again: (P,) which places are meant; filled: whether the limit was too low.
    """
    law = (elasticity, exponent, reference)
    ground, told = Ground(points, taxel, border), Told(loads, info, entry, entries, entry_loads)
    room = 1
    for p in range(at.shape[0]):
        room = max(room, begins[p + 1] - begins[p])
    sums = np.empty(loads.shape[1] + 1)
    scratch = room_for(room, sums)
    found, which = scratch.found, scratch.which
    for p in range(at.shape[0]):
        if not again[p]:
            continue
        row = rows[at[p]]
        frame = frame_of(row, turned)
        ox, oy, oz = row[3], row[4], row[5]
        dx, dy, dz = local(frame, frame[0], frame[1], frame[2])
        again[p] = False
        own = (starts[p], starts[p + 1])
        first = FAR
        count = begins[p + 1] - begins[p]
        for i in range(count):
            k = cast[begins[p] + i]
            f = face[begins[p] + i]
            gap, cosine = FAR, 0.0
            if f >= 0:
                x, y, z = local(frame, points[0, k] - ox, points[1, k] - oy, points[2, k] - oz)
                cosine = normals[f, 0] * dx + normals[f, 1] * dy + normals[f, 2] * dz
                if cosine != 0:
                    gap = (heights[f] - (normals[f, 0] * x + normals[f, 1] * y + normals[f, 2] * z)) / cosine
            carries = points[3, k] * frame[0] + points[4, k] * frame[1] + points[5, k] * frame[2]
            which[0, i] = k
            found[0, i] = gap
            found[1, i] = carries if gap < FAR else 0.0
            found[2, i] = abs(cosine)
            first = min(first, gap)
        if first >= FAR:
            if limits[p] < math.inf:
                limits[p] = math.inf
                again[p] = True
            else:
                x, y, z = outside(frame, middle[0], middle[1], middle[2])
                untouched(points, frame, (ox + x, oy + y, oz + z), own, info)
            continue
        for i in range(count):
            found[0, i] -= first
        most = largest(force, info, own[0], own[1]) / elasticity
        start = max(limits[p] - first, 0.0)
        level = carry(
            ground, scratch, count, first, start, limits[p], most, law, through, own, force, told
        )  # fmt: skip
        again[p] = level > limits[p]
        limits[p] = level
