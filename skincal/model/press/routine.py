"""Presses of closed-form indenters: the compiled routine from contacts to loads, for batches and single presses.

The level of a press is the distance, from points to the indenter along the contact normal, up to which points carry
load: the smallest distance plus the penetration. Only tiles with a lower bound within a guessed limit are processed.
Points that are left out could only carry part of the force, so the level without them is an upper bound. If it stays
within the limit, none of them is reached, and it is the exact level of all points. Otherwise it is a sufficient limit
for the next pass.

The sums run over the carrying points only, in the order of the tiles: the result of a press depends neither on the
other presses of a batch nor on the limit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from skincal.model.arrays import FloatArray, IntArray
from skincal.model.press.balance import Law, depth_of
from skincal.model.press.jit import device, plain_device
from skincal.model.press.meet import FAR, Frame, bound_tile, meet, paraboloid
from skincal.model.response import Status

AHEAD = 1.15
"""Limit of the first pass over the guessed depth. A guess that is too low only costs a second pass."""
SKIN_BEND = 40.0
"""Half the curvature of a fingertip of 12 mm [1/m]; it only affects the initial guess of Newton's method."""
_CELL = 0.75
"""Bound of a cell's squared half diagonal over its area: 1/2 for a square, 5/8 for an aspect ratio of 2."""


class Ground(NamedTuple):
    """The patch: ``points`` (6, N), ``taxel`` (N,) and ``border`` (N,) of :func:`press`."""

    points: FloatArray
    taxel: IntArray
    border: FloatArray


class Scratch(NamedTuple):
    """Work arrays for the points of a press.

    ``found`` (3, room) holds gaps, weights and facing from :func:`gather`, ``active`` (3, room) those of the carrying
    points, ``which`` (2, room) the indices of both, and ``sums`` (J + 1,) the loads of the taxels.
    """

    found: FloatArray
    active: FloatArray
    which: IntArray
    sums: FloatArray


class PressOutput(NamedTuple):
    """Output arrays: ``loads`` (K, J), ``info`` (K, 7), ``entry`` (K,), ``entries`` (n,) and ``entry_loads`` (n,)."""

    loads: FloatArray
    info: FloatArray
    entry: IntArray
    entries: IntArray
    entry_loads: FloatArray


OK, AT_BORDER, THROUGH_FINGER = int(Status.OK), int(Status.AT_BORDER), int(Status.THROUGH_FINGER)
NO_FORCE, UNKNOWN, PRESSES = int(Status.NO_FORCE), int(Status.UNKNOWN), -1
NOT_TOUCHED, FINER_THAN_POINTS = int(Status.NOT_TOUCHED), int(Status.FINER_THAN_POINTS)


@device
def frame_of(row: FloatArray, turned: bool) -> Frame:
    """Return the contact normal and the axes of the indenter's frame.

    Args:
        row: (18,) normal, origin, rotation row by row, point of contact.
        turned: True if the rotation is given; else it is that of :func:`skincal.model.contact_rotations`.
    """
    nx, ny, nz = row[0], row[1], row[2]
    if turned:
        return (
            nx, ny, nz,
            row[6], row[9], row[12],
            row[7], row[10], row[13],
            row[8], row[11], row[14],
        )  # fmt: skip
    yx, yy, yz = -ny * nx, 1.0 - ny * ny, -ny * nz
    length = math.sqrt(yx * yx + yy * yy + yz * yz)
    if length < 1e-6:
        yx, yy, yz = 0.0, nz, -ny
        length = math.sqrt(yy * yy + yz * yz)
    yx /= length
    yy /= length
    yz /= length
    return (
        nx, ny, nz,
        yy * nz - yz * ny, yz * nx - yx * nz, yx * ny - yy * nx,
        yx, yy, yz,
        nx, ny, nz,
    )  # fmt: skip


@device
def guess_level(
    middle: FloatArray, weight: FloatArray, gap: FloatArray, area: FloatArray, load: float, bend: float,
    exponent: float, reference: float,
) -> tuple[float, float]:  # fmt: skip
    """Guess the level of a press, taking the bound for the indenter and tiles for points.

    Args:
        middle: (B,) distances of the bound at the middles of the tiles [m].
        weight: (B,) areas of the tiles along the normal [m²].
        gap: (B,) scratch.
        area: (B,) scratch.
        load: F / E [m³].
        bend: ``bend`` of the bound [1/m].
        exponent: exponent of the law.
        reference: reference penetration of the law [m].

    Returns:
        The level, and the smallest distance of a tile [m]; inf if no tile is hit.
    """
    tiles = middle.shape[0]
    first = FAR
    for b in range(tiles):
        first = min(first, middle[b])
    if first >= FAR:
        return math.inf, math.inf
    start = math.sqrt(2.0 * load * (bend + SKIN_BEND) / math.pi)
    # The first Newton step leads to the solution or above it: tiles beyond that depth carry nothing.
    carried = 0.0
    moment = 0.0
    for b in range(tiles):
        carries = 1.0 if middle[b] <= first + start else 0.0
        carried += weight[b] * carries
        moment += weight[b] * (middle[b] - first) * carries
    depth = (load + moment) / carried
    count = 0
    for b in range(tiles):
        # Under a nonlinear law the level may be deeper, so that all tiles are kept.
        if weight[b] > 0 and (exponent != 1.0 or middle[b] <= first + depth):
            gap[count] = middle[b] - first
            area[count] = weight[b]
            count += 1
    depth = depth_of(gap, area, count, load, depth, (1.0, exponent, reference))
    return first + depth, first


@device
def gather(
    kind: int, size: float, frame: Frame, origin: tuple[float, float, float], points: FloatArray,
    begin: FloatArray, each: int, limit: float, scratch: Scratch,
) -> tuple[int, float]:  # fmt: skip
    """Collect the points of the tiles within a limit; return their number, and the smallest distance [m].

    ``begin`` (B,) are the tiles' lower bounds from :func:`~skincal.model.press.meet.bound_tile`, and ``each`` is the
    number of points of a tile. For each point this fills its gap (distance beyond the smallest one, about ``FAR``
    without a hit [m]), weight (area along the normal, 0 without a hit [m²]), facing (max(-n_s . n_c, 0)) and index.
    """
    gap, weight, facing = scratch.found[0], scratch.found[1], scratch.found[2]
    which, place = scratch.which[0], scratch.active
    nx, ny, nz = frame[0], frame[1], frame[2]
    ox, oy, oz = origin
    count = 0
    for b in range(begin.shape[0]):
        if begin[b] <= limit:
            for i in range(each):
                k = b * each + i
                place[0, count + i] = points[0, k] - ox
                place[1, count + i] = points[1, k] - oy
                place[2, count + i] = points[2, k] - oz
                weight[count + i] = points[3, k] * nx + points[4, k] * ny + points[5, k] * nz
                which[count + i] = k
            count += each
    meet(kind, size, frame, place, count, gap, facing)
    first = FAR
    for i in range(count):
        met = weight[i] > 0 and gap[i] < FAR
        weight[i] = weight[i] if met else 0.0
        gap[i] = gap[i] if met else FAR
        first = min(first, gap[i])
    for i in range(count):
        gap[i] -= first
    return count, first


@device
def is_over_cell(points: FloatArray, k: int, frame: Frame, axis: tuple[float, float, float]) -> bool:
    """Return True if an axis along the contact normal passes through the cell of point k and the cell faces it."""
    nx, ny, nz = frame[0], frame[1], frame[2]
    x = points[0, k] - axis[0]
    y = points[1, k] - axis[1]
    z = points[2, k] - axis[2]
    along = x * nx + y * ny + z * nz
    carries = points[3, k] * nx + points[4, k] * ny + points[5, k] * nz
    area = math.sqrt(points[3, k] ** 2 + points[4, k] ** 2 + points[5, k] ** 2)
    return carries > 0 and x * x + y * y + z * z - along * along <= _CELL * area


@device
def set_untouched(
    points: FloatArray, frame: Frame, axis: tuple[float, float, float], samples: tuple[int, int],
    info: FloatArray,
) -> None:  # fmt: skip
    """Set the status of samples that touch no point: an indenter above a cell is finer than the points."""
    over = False
    for k in range(points.shape[1]):
        over = over or is_over_cell(points, k, frame, axis)
    status = FINER_THAN_POINTS if over else NOT_TOUCHED
    for s in range(samples[0], samples[1]):
        if info[s, 6] == PRESSES:
            info[s, 6] = status


@device
def allocate_scratch(count: int, sums: FloatArray) -> Scratch:
    """Allocate work arrays for ``count`` points."""
    return Scratch(np.empty((3, count)), np.empty((3, count)), np.empty((2, count), np.int64), sums)


@device
def fill_press(
    ground: Ground, scratch: Scratch, count: int, depth: float, load: float, law: Law, through: float,
    output: PressOutput, s: int,
) -> None:  # fmt: skip
    """Fill in the outputs of one press from its carrying points; its depth is solved again from these points alone.

    Args:
        ground: the patch.
        scratch: result of :func:`gather`, and work arrays.
        count: number of points found.
        depth: depth from :func:`depth_of` [m].
        load: F / E [m³].
        law: E [Pa/m], exponent and reference [m].
        through: largest valid penetration [m].
        output: filled for press s. ``entry`` is the start of the press in ``entries`` and ``entry_loads``; if these are
            not empty, they are filled with the indices of the points with a load, and their loads [N].
        s: index of the press.
    """
    found, active, which, sums = scratch
    points, taxel, border = ground
    loads, info = output.loads[s], output.info[s]
    entries, entry_loads, entry = output.entries, output.entry_loads, output.entry[s]
    elasticity, exponent, reference = law
    some = 0
    for i in range(count):
        # Always write, and advance only if the point carries: this avoids mispredicted branches.
        active[0, some] = found[0, i]
        active[1, some] = found[1, i]
        active[2, some] = found[2, i]
        which[1, some] = which[0, i]
        some += 1 if found[0, i] <= depth and found[1, i] > 0 else 0
    depth = depth_of(active[0], active[1], some, load, depth, law)
    force = 0.0
    touched = 0
    for i in range(some):
        local = max(depth - active[0, i], 0.0)
        touched += 1 if local > 0 else 0
        if exponent != 1.0:
            local = reference * (local / reference) ** exponent
        active[1, i] *= elasticity * local
        force += active[1, i]
    for j in range(sums.shape[0]):
        sums[j] = 0.0
    for i in range(some):
        sums[taxel[which[1, i]] + 1] += active[1, i] * active[2, i]
    for j in range(loads.shape[0]):
        loads[j] = sums[j + 1]
    if entries.shape[0] > 0:
        for i in range(some):
            if active[1, i] > 0:
                entries[entry] = which[1, i]
                entry_loads[entry] = active[1, i] * active[2, i]
                entry += 1
    x = y = z = edge = 0.0
    for i in range(some):
        k = which[1, i]
        x += active[1, i] * points[0, k]
        y += active[1, i] * points[1, k]
        z += active[1, i] * points[2, k]
        edge += active[1, i] * border[k]
    info[0] = depth
    info[1] = force
    if force > 0:
        info[2], info[3], info[4] = x / force, y / force, z / force
    info[5] = touched
    info[6] = AT_BORDER if edge > 0 else OK
    if depth > through:
        info[6] = THROUGH_FINGER


@device
def solve_place(
    ground: Ground, scratch: Scratch, count: int, first: float, start: float, limit: float, most: float,
    law: Law, through: float, samples: tuple[int, int], force: FloatArray, output: PressOutput,
) -> float:  # fmt: skip
    """Return the level of the largest force at a place [m]; fill in all its presses if the level is within the limit.

    Besides the arguments of :func:`fill_press`: ``first`` is the smallest distance, ``start`` the initial guess of the
    depth and ``limit`` the limit of the collected points [m]; ``most`` is the largest force over E [m³]; ``samples``
    are the first sample of the place and the one after its last, and ``force`` the forces of all samples [N].
    """
    deepest = depth_of(scratch.found[0], scratch.found[1], count, most, start, law)
    if first + deepest <= limit:
        for s in range(samples[0], samples[1]):
            if output.info[s, 6] != PRESSES:
                continue
            load = force[s] / law[0]
            depth = deepest
            if load != most:
                depth = depth_of(scratch.found[0], scratch.found[1], count, load, depth, law)
            fill_press(ground, scratch, count, depth, load, law, through, output, s)
    return first + deepest


@device
def largest_force(force: FloatArray, info: FloatArray, first: int, last: int) -> float:
    """Return the largest force of the samples from ``first`` to before ``last`` that press [N]."""
    most = 0.0
    for s in range(first, last):
        if info[s, 6] == PRESSES:
            most = max(most, force[s])
    return most


@plain_device
def is_unknown(row: FloatArray, force: float, turned: bool) -> bool:
    """Return True if a force or a number of its position is NaN or infinite."""
    known = abs(force) < math.inf
    for i in range(18):
        if turned or not 6 <= i < 15:
            known = known and abs(row[i]) < math.inf
    return not known


@device
def group(
    rows: FloatArray, turned: bool, force: FloatArray, loads: FloatArray, info: FloatArray,
    starts: IntArray, at: IntArray,
) -> int:  # fmt: skip
    """Group consecutive samples at exactly the same place; return the number of places.

    For ``rows``, ``turned`` and ``force`` see :func:`press`. The status in ``info`` is set to ``PRESSES`` or to the
    reason why a sample does not press; ``loads`` is set to NaN where a sample is not known. ``starts`` (K + 1,) and
    ``at`` (K,) are filled: place p has the samples from ``starts[p]`` to before ``starts[p + 1]``, some of which may
    not press, and the row ``at[p]``.
    """
    places = 0
    for s in range(force.shape[0]):
        if is_unknown(rows[s], force[s], turned):
            info[s, 6] = UNKNOWN
            for j in range(loads.shape[1]):
                loads[s, j] = math.nan
            for i in range(5):
                info[s, i] = math.nan
            continue
        for i in range(2, 5):
            info[s, i] = math.nan
        if force[s] <= 0:
            info[s, 6] = NO_FORCE
            continue
        info[s, 6] = PRESSES
        same = places > 0
        if same:
            for i in range(18 if turned else 6):
                same = same and rows[s, i] == rows[at[places - 1], i]
        if not same:
            starts[places] = s
            at[places] = s
            places += 1
    starts[places] = force.shape[0]
    return places


def press(
    points: FloatArray, taxel: IntArray, border: FloatArray, tiles: FloatArray, kind: int, size: float,
    through: float, rows: FloatArray, turned: bool, force: FloatArray, elasticity: float,
    exponent: float, reference: float, loads: FloatArray, info: FloatArray, entry: IntArray,
    entries: IntArray, entry_loads: FloatArray,
) -> None:  # fmt: skip
    """Press a closed-form indenter on a patch.

    Args:
        points: (6, N) see :class:`skincal.model.press.points.TiledPoints`.
        taxel: (N,) the same.
        border: (N,) the same.
        tiles: (11, B) the same.
        kind: number of the closed form.
        size: length that describes the indenter [m].
        through: largest valid penetration [m].
        rows: (K, 18) places: normal, origin, rotation row by row, point of contact.
        turned: True if rotations are given.
        force: (K,) forces [N].
        elasticity: E [Pa/m].
        exponent: exponent of the law; 1: linear.
        reference: reference penetration of the law [m].
        loads: (K, J) output, initially zero [N].
        info: (K, 7) output, initially zero: see :data:`skincal.model.press.call.INFO`.
        entry: (K,) start of each press in the following two arrays.
        entries: (n,) output: see :func:`fill_press`.
        entry_loads: (n,) output: the same.
    """
    law = (elasticity, exponent, reference)
    samples = force.shape[0]
    starts, at = np.empty(samples + 1, np.int64), np.empty(samples, np.int64)
    places = group(rows, turned, force, loads, info, starts, at)
    count_tiles = tiles.shape[1]
    each = points.shape[1] // max(count_tiles, 1)
    begin, middle, area = np.empty(count_tiles), np.empty(count_tiles), np.empty(count_tiles)
    coarse = np.empty((2, count_tiles))
    ground, output = Ground(points, taxel, border), PressOutput(loads, info, entry, entries, entry_loads)
    sums = np.empty(loads.shape[1] + 1)
    scratch = allocate_scratch(1024, sums)
    for p in range(places):
        row = rows[at[p]]
        frame = frame_of(row, turned)
        normal = (frame[0], frame[1], frame[2])
        origin = (row[3], row[4], row[5])
        ax, ay, az, nearest, bend, reach = paraboloid(kind, size, frame)
        axis = (origin[0] + ax, origin[1] + ay, origin[2] + az)
        for b in range(count_tiles):
            begin[b], middle[b], area[b] = bound_tile(tiles, b, normal, axis, nearest, bend, reach)
        own = (starts[p], starts[p + 1])
        most = largest_force(force, info, own[0], own[1]) / elasticity
        level, first = guess_level(middle, area, coarse[0], coarse[1], most, bend, exponent, reference)
        limit = first + AHEAD * (level - first) if level < math.inf else math.inf
        while True:
            need = 0
            for b in range(count_tiles):
                need += each if begin[b] <= limit else 0
            if need > scratch.found.shape[1]:
                scratch = allocate_scratch(need, sums)
            count, first = gather(kind, size, frame, origin, points, begin, each, limit, scratch)
            if first < FAR:
                start = max(min(level, limit) - first, 0.0)
                level = solve_place(
                    ground, scratch, count, first, start, limit, most, law, through, own, force, output
                )
                if level <= limit:
                    break
                limit = level
            elif limit < math.inf:
                limit = math.inf
            else:
                set_untouched(points, frame, axis, own, info)
                break
