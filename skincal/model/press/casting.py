"""Presses of meshes: selection of the points that need a ray, and the loads from the rays' hits (embree).

Each connected part of a mesh is bounded by a paraboloid: a point for which all paraboloids are farther than a limit has
no hit within that limit. Results therefore do not depend on the bounds.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from skincal.model.arrays import BoolArray, FloatArray, IntArray
from skincal.model.press.jit import device
from skincal.model.press.meet import FAR, ROUNDING, Frame
from skincal.model.press.routine import (
    Ground,
    PressOutput,
    allocate_scratch,
    frame_of,
    guess_level,
    largest_force,
    set_untouched,
    solve_place,
)

BOUND = 13
"""Number of values of a paraboloid: point on its axis (3), side direction (3), ``slope``, ``nearest``, three ``bend``,
two ``reach``.

The axis runs along the contact normal. Let r be the distance of a point of the part from the axis, s its component
along the side direction and w the one across it. The point lies at least ``nearest`` + ``slope`` s + max(bend_0 r²,
bend_1 s², bend_2 w²) along the normal; r and \\|s\\| are at most the two ``reach``.
"""
_WIDER = 1.0 + 1e-9
"""Widening of ``reach``, so that rounding does not exclude a point on the rim."""
_SLACKS_M = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
"""Candidate distances of a paraboloid's apex ahead of the nearest vertex; a larger one allows a larger curvature."""
_DEPTH_M, _FLAT = 2e-4, 20.0
"""Typical penetration [m] and half the curvature of the skin [1/m], for which the best paraboloid is chosen."""
_LEAST_ACROSS = 0.1
"""Smallest sine of the angle between the normal and a part's long axis at which the bound has a slope."""


@device
def _across(
    x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[float, float, float, float]:
    """Return the component of a vector perpendicular to a unit vector, as a unit vector and its length."""
    along = x * dx + y * dy + z * dz
    x -= along * dx
    y -= along * dy
    z -= along * dz
    length = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / max(length, 1e-12)
    return x * scale, y * scale, z * scale, length


@device
def to_indenter(frame: Frame, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Rotate a vector from the fingertip frame to the indenter's frame."""
    return (
        x * frame[3] + y * frame[4] + z * frame[5],
        x * frame[6] + y * frame[7] + z * frame[8],
        x * frame[9] + y * frame[10] + z * frame[11],
    )


@device
def to_fingertip(frame: Frame, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Rotate a vector from the indenter's frame to the fingertip frame."""
    return (
        x * frame[3] + y * frame[6] + z * frame[9],
        x * frame[4] + y * frame[7] + z * frame[10],
        x * frame[5] + y * frame[8] + z * frame[11],
    )


def enclose(
    vertices: FloatArray, parts: IntArray, axes: FloatArray, middles: FloatArray, rows: FloatArray,
    turned: bool, at: IntArray, bounds: FloatArray,
) -> None:  # fmt: skip
    """Bound the parts of a mesh by paraboloids, in its own frame.

    The set behind a paraboloid is convex: if it contains all vertices of a part, it contains its faces. Candidates have
    their axis through the part's middle or the contact point, and their apex slightly ahead of the nearest vertex. The
    one that is expected to leave the fewest points is chosen.

    Args:
        vertices: (V, 3) vertices of convex hulls, part by part [m].
        parts: (Q + 1,) first vertex of each part.
        axes: (Q, 4) long axis of each part, and 1 if it is much longer than wide, else 0.
        middles: (Q, 3) middle of each part [m].
        rows: (K, 18) see :func:`skincal.model.press.routine.press`.
        turned: the same.
        at: (P,) rows of places.
        bounds: (P, Q, 13) output: see :data:`BOUND`.
    """
    most = 0
    for q in range(parts.shape[0] - 1):
        most = max(most, parts[q + 1] - parts[q])
    height, along_2, aside_2 = np.empty(most), np.empty(most), np.empty(most)
    for k in range(at.shape[0]):
        row = rows[at[k]]
        frame = frame_of(row, turned)
        dx, dy, dz = to_indenter(frame, frame[0], frame[1], frame[2])
        tx, ty, tz = to_indenter(frame, row[15] - row[3], row[16] - row[4], row[17] - row[5])
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
                    side = x * sx + y * sy + z * sz
                    height[i] = ahead - slope * side
                    along_2[i] = side * side
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
    """Lower ``begin`` and ``near`` (B,) [m] to the bounds by one part; see :func:`skincal.model.press.meet.bound_tile`.

    ``begin`` is a lower bound for all points of a tile, ``near`` the bound at its middle.
    """
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
def earliest_hit(bound: FloatArray, frame: Frame, x: float, y: float, z: float) -> float:
    """Return a lower bound of the distance at which a point hits a part [m]; inf if it misses the part.

    The point (x, y, z) is relative to the origin of the indenter's frame, in the axes of the fingertip frame.
    """
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
    wanted: BoolArray, middle: FloatArray, back: float, scale: float, begins: IntArray,
) -> tuple[IntArray, NDArray[np.float32], NDArray[np.float32]]:  # fmt: skip
    """Select the points that may hit the mesh within a limit, and return their rays for embree.

    Arguments that are not listed are those of :func:`skincal.model.press.routine.press`.

    Args:
        starts: (P + 1,) see :func:`skincal.model.press.routine.group`.
        at: (P,) the same.
        bounds: (P or 1, Q, 13) from :func:`enclose`.
        limits: (P,) limits of the distance [m]; minus infinity is replaced by a guess.
        guesses: (2, P) output where a limit is guessed: the level if the mesh filled its bound, and the distance at
            which the bound is first touched [m].
        ahead: search depth, over the depth of that level.
        wanted: (P,) places to process.
        middle: (3,) middle of the mesh, its own frame [m].
        back: distance from the middle at which rays start [m].
        scale: scale of embree's scene.
        begins: (P + 1,) output: first result of each place.

    Returns:
        Indices of the points (n,), and starts (n, 3) and directions (n, 3) of their rays, scaled, single precision.
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
        if not wanted[p]:
            continue
        row = rows[at[p]]
        frame = frame_of(row, turned)
        ox, oy, oz = row[3], row[4], row[5]
        for b in range(count_tiles):
            begin[b], near[b] = math.inf, FAR
        for q in range(parts):
            own = bounds[p if bounds.shape[0] > 1 else 0, q]
            bound[q, 0], bound[q, 1], bound[q, 2] = to_fingertip(frame, own[0], own[1], own[2])
            bound[q, 3], bound[q, 4], bound[q, 5] = to_fingertip(frame, own[3], own[4], own[5])
            for i in range(6, BOUND):
                bound[q, i] = own[i]
            bound_tiles_by_part(tiles, frame, (ox, oy, oz), bound[q], begin, near)
        for b in range(count_tiles):
            facing = tiles[4, b] * frame[0] + tiles[5, b] * frame[1] + tiles[6, b] * frame[2]
            met = facing > 0 and near[b] < FAR
            area[b] = facing if met else 0.0
            near[b] = near[b] if met else FAR
        if limits[p] < -FAR:
            most = largest_force(force, info, starts[p], starts[p + 1]) / elasticity
            level, first = guess_level(near, area, coarse[0], coarse[1], most, _FLAT, exponent, reference)
            limits[p] = first + ahead * (level - first) if level < math.inf else math.inf
            guesses[0, p], guesses[1, p] = level, first
        mx, my, mz = to_fingertip(frame, middle[0], middle[1], middle[2])
        wx, wy, wz = to_indenter(frame, frame[0], frame[1], frame[2])
        for b in range(count_tiles):
            if begin[b] > limits[p] or begin[b] == math.inf:
                continue
            if n + each > room:
                room = 2 * room + each
                more = np.empty(room, np.int64)
                more_rays, more_ways = np.empty((room, 3), np.float32), np.empty((room, 3), np.float32)
                # Loops: numba takes seconds to compile an assignment of slices.
                for i in range(n):
                    more[i] = which[i]
                    for c in range(3):
                        more_rays[i, c], more_ways[i, c] = rays[i, c], ways[i, c]
                which, rays, ways = more, more_rays, more_ways
            for k in range(b * each, b * each + each):
                x, y, z = points[0, k] - ox, points[1, k] - oy, points[2, k] - oz
                soonest = math.inf
                for q in range(parts):
                    soonest = min(soonest, earliest_hit(bound[q], frame, x, y, z))
                carries = points[3, k] * frame[0] + points[4, k] * frame[1] + points[5, k] * frame[2]
                if soonest > limits[p] or soonest == math.inf or carries <= 0:
                    continue
                which[n] = k
                x, y, z = x - mx, y - my, z - mz
                shift = x * frame[0] + y * frame[1] + z * frame[2] + back
                a, b_, c_ = to_indenter(
                    frame, x - shift * frame[0], y - shift * frame[1], z - shift * frame[2]
                )
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
    """Compute presses of a mesh from the triangles that the rays hit.

    Arguments that are not listed are those of :func:`skincal.model.press.routine.press`.

    Args:
        starts: (P + 1,) see :func:`skincal.model.press.routine.group`.
        at: (P,) the same.
        cast: (n,) points whose rays were cast, place by place, from :func:`select`.
        begins: (P + 1,) first of these points at each place.
        face: (n,) triangle that each ray hits; -1: none.
        normals: (F, 3) normals of the triangles.
        heights: (F,) distances of their planes from the mesh's origin [m].
        middle: (3,) middle of the mesh, its own frame [m].
        limits: (P,) limits of the search [m]; replaced by the levels that were found, as limits of the next search.
        again: (P,) places to process; replaced by whether the limit was too low.
    """
    law = (elasticity, exponent, reference)
    ground, output = Ground(points, taxel, border), PressOutput(loads, info, entry, entries, entry_loads)
    room = 1
    for p in range(at.shape[0]):
        room = max(room, begins[p + 1] - begins[p])
    sums = np.empty(loads.shape[1] + 1)
    scratch = allocate_scratch(room, sums)
    found, which = scratch.found, scratch.which
    for p in range(at.shape[0]):
        if not again[p]:
            continue
        row = rows[at[p]]
        frame = frame_of(row, turned)
        ox, oy, oz = row[3], row[4], row[5]
        dx, dy, dz = to_indenter(frame, frame[0], frame[1], frame[2])
        again[p] = False
        own = (starts[p], starts[p + 1])
        first = FAR
        count = begins[p + 1] - begins[p]
        for i in range(count):
            k = cast[begins[p] + i]
            f = face[begins[p] + i]
            gap, cosine = FAR, 0.0
            if f >= 0:
                x, y, z = to_indenter(frame, points[0, k] - ox, points[1, k] - oy, points[2, k] - oz)
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
                x, y, z = to_fingertip(frame, middle[0], middle[1], middle[2])
                set_untouched(points, frame, (ox + x, oy + y, oz + z), own, info)
            continue
        for i in range(count):
            found[0, i] -= first
        most = largest_force(force, info, own[0], own[1]) / elasticity
        start = max(limits[p] - first, 0.0)
        level = solve_place(
            ground, scratch, count, first, start, limits[p], most, law, through, own, force, output
        )  # fmt: skip
        again[p] = level > limits[p]
        limits[p] = level
