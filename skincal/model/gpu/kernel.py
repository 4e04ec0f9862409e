"""The GPU kernel of a press: one block of threads runs the algorithm of :mod:`skincal.model.press.routine` in parallel.

Computations for one point, tile or step are the same device functions as on the CPU. The order of sums is not fixed, so
that results agree up to rounding.
"""

from __future__ import annotations

import math
from typing import Any

import numba

from skincal.model.gpu.target import cooperative, cuda
from skincal.model.press.balance import NO_END, power_step
from skincal.model.press.meet import FAR, bound_tile, meet_point, paraboloid
from skincal.model.press.routine import (
    AHEAD,
    AT_BORDER,
    FINER_THAN_POINTS,
    NO_FORCE,
    NOT_TOUCHED,
    OK,
    SKIN_BEND,
    THROUGH_FINGER,
    UNKNOWN,
    frame_of,
    is_over_cell,
    is_unknown,
)

REAL: Any = numba.float64
"""The type of real numbers."""
BLOCK = 128
"""Number of threads per press."""
POINTS, TILES, TAXELS = 1536, 1024, 256
"""Numbers of points, tiles and taxels that fit into shared memory; beyond these, global memory is used."""
_TRIES = 12
"""Number of passes over the points, each with a higher limit, before a pass over all points."""
_WIDER = 1.0 + 1e-5
"""Widening of the limit, so that rounding in the order of sums does not cause another pass."""
_PI, _NAN = math.pi, math.nan
_STEPS = 200
"""Largest number of Newton steps, as in :mod:`skincal.model.press.balance`."""


@cooperative
def _sum(a: Any, b: Any, held: Any, t: int) -> Any:
    """Return the sums of two numbers over the threads of a block; ``held`` (2, BLOCK) is scratch."""
    held[0, t] = a
    held[1, t] = b
    cuda.syncthreads()
    half = BLOCK // 2
    while half > 0:
        if t < half:
            held[0, t] += held[0, t + half]
            held[1, t] += held[1, t + half]
        cuda.syncthreads()
        half //= 2
    a = held[0, 0]
    b = held[1, 0]
    cuda.syncthreads()
    return a, b


@cooperative
def _least(a: Any, held: Any, t: int) -> Any:
    """Return the minimum of a number over the threads of a block; ``held`` (2, BLOCK) is scratch."""
    held[0, t] = a
    cuda.syncthreads()
    half = BLOCK // 2
    while half > 0:
        if t < half:
            held[0, t] = min(held[0, t], held[0, t + half])
        cuda.syncthreads()
        half //= 2
    a = held[0, 0]
    cuda.syncthreads()
    return a


@cooperative
def _read(counts: Any, which: int) -> int:
    """Return a count that all threads have added to; after the second barrier a thread may reset it."""
    cuda.syncthreads()
    count = counts[which]
    cuda.syncthreads()
    return count


@cooperative
def _nearest_tile(
    tiles: Any, normal: Any, axis: Any, nearest: Any, bend: Any, reach: Any, held: Any, t: int
) -> Any:
    """Return the smallest distance at the middle of a tile [m]; ``FAR`` if no tile is hit."""
    first = FAR
    for b in range(t, tiles.shape[1], BLOCK):
        _, middle, _ = bound_tile(tiles, b, normal, axis, nearest, bend, reach)
        first = min(first, middle)
    return _least(first, held, t)


@cooperative
def _list_tiles(
    tiles: Any, normal: Any, axis: Any, nearest: Any, bend: Any, reach: Any, limit: Any, listed: Any,
    counts: Any, t: int,
) -> int:  # fmt: skip
    """List the tiles whose lower bound is within a limit; return their number."""
    if t == 0:
        counts[0] = 0
    cuda.syncthreads()
    for b in range(t, tiles.shape[1], BLOCK):
        begin, _, _ = bound_tile(tiles, b, normal, axis, nearest, bend, reach)
        if begin <= limit:
            listed[cuda.atomic.add(counts, 0, 1)] = b
    return _read(counts, 0)


@cooperative
def _gather(
    kind: int, size: Any, frame: Any, origin: Any, points: Any, each: int, listed: Any, tiles: int, limit: Any,
    found: Any, which: Any, counts: Any, t: int,
) -> int:  # fmt: skip
    """Collect distances, weights and facing of points nearer than a limit; return the number of points."""
    if t == 0:
        counts[1] = 0
    cuda.syncthreads()
    for q in range(t, tiles * each, BLOCK):
        i = listed[q // each] * each + q % each
        weight = points[3, i] * frame[0] + points[4, i] * frame[1] + points[5, i] * frame[2]
        if weight > 0:
            x = points[0, i] - origin[0]
            y = points[1, i] - origin[1]
            z = points[2, i] - origin[2]
            gap, facing = meet_point(kind, size, frame, x, y, z)
            if gap <= limit and gap < FAR:
                s = cuda.atomic.add(counts, 1, 1)
                if s < which.shape[0]:
                    found[0, s] = gap
                    found[1, s] = weight
                    found[2, s] = facing
                    which[s] = i
    return _read(counts, 1)


@cooperative
def _depth(
    found: Any, count: int, load: Any, start: Any, exponent: Any, reference: Any, held: Any, t: int
) -> Any:
    """Return the depth at which points carry a load; see :func:`skincal.model.press.balance.depth_of`."""
    depth = start
    for step in range(_STEPS):
        area = 0.0
        moment = 0.0
        for i in range(t, count, BLOCK):
            carries = found[1, i] if found[0, i] <= depth else 0.0
            area += carries
            moment += carries * found[0, i]
        area, moment = _sum(area, moment, held, t)
        lower = (load + moment) / area
        if step > 0 and not lower < depth:
            break
        depth = lower
    if exponent == 1.0:
        return depth
    low = 0.0
    high = NO_END
    for _ in range(_STEPS):
        total = 0.0
        slope = 0.0
        for i in range(t, count, BLOCK):
            local = depth - found[0, i]
            if local > 0:
                stress = reference * (local / reference) ** exponent * found[1, i]
                total += stress
                slope += stress / local
        total, slope = _sum(total, slope, held, t)
        depth, low, high, done = power_step(depth, low, high, total, slope, load, exponent)
        if done:
            break
    return depth


@cooperative
def _sum_loads(
    found: Any, which: Any, count: int, depth: Any, elasticity: Any, exponent: Any, reference: Any,
    taxel: Any, border: Any, sums: Any, counts: Any, t: int,
) -> bool:  # fmt: skip
    """Sum the loads of the points into ``sums`` (J,) of the taxels [N]; return True if the border is touched."""
    if t == 0:
        counts[0] = 0
    for j in range(t, sums.shape[0], BLOCK):
        sums[j] = 0.0
    cuda.syncthreads()
    for i in range(t, count, BLOCK):
        local = depth - found[0, i]
        if local > 0:
            if exponent != 1.0:
                local = reference * (local / reference) ** exponent
            k = which[i]
            if border[k] > 0:
                cuda.atomic.add(counts, 0, 1)
            if taxel[k] >= 0:
                cuda.atomic.add(sums, taxel[k], elasticity * local * found[1, i] * found[2, i])
    return _read(counts, 0) > 0


@cooperative
def _untouched_status(points: Any, frame: Any, axis: Any, counts: Any, t: int) -> int:
    """Return the status of a press that touches no point: see :func:`skincal.model.press.routine.set_untouched`."""
    if t == 0:
        counts[0] = 0
    cuda.syncthreads()
    for i in range(t, points.shape[1], BLOCK):
        if is_over_cell(points, i, frame, axis):
            cuda.atomic.add(counts, 0, 1)
    return FINER_THAN_POINTS if _read(counts, 0) > 0 else NOT_TOUCHED


def press(  # noqa: D417
    points: Any, taxel: Any, border: Any, tiles: Any, middle: Any, kind: int, size: Any, through: Any,
    normals: Any, origins: Any, rotations: Any, turned: bool, force: Any, elasticity: Any, exponent: Any,
    reference: Any, scale: Any, low: Any, high: Any, whole: bool, far_found: Any, far_which: Any, far_listed: Any,
    image: Any, depths: Any, statuses: Any,
) -> None:  # fmt: skip
    """Kernel: compute images, penetrations and statuses of K presses; each block takes one press after the other.

    Arguments that are not listed are those of :func:`skincal.model.press.routine.press`, relative to ``middle``.

    Args:
        middle: (3,) origin of ``points`` and ``tiles``, in double precision [m].
        normals: (K, 3) contact normals.
        origins: (K, 3) origins of the indenter's frame [m].
        rotations: (K, 9) from the indenter's frame to the fingertip's; (1, 9) and unused if not ``turned``.
        scale: (J,) counts per newton [1/N].
        low: lowest value of the converter [counts].
        high: highest value of the converter [counts].
        whole: True if the converter rounds.
        far_found: (blocks, 3, N) scratch, for presses that do not fit into shared memory.
        far_which: (blocks, N) the same.
        far_listed: (blocks, B) the same.
        image: (K, J) output: images [counts].
        depths: (K,) output: penetrations [m].
        statuses: (K,) output: values of :class:`skincal.model.Status`.
    """
    near_found = cuda.shared.array((3, POINTS), REAL)
    near_which = cuda.shared.array(POINTS, numba.int32)
    near_listed = cuda.shared.array(TILES, numba.int32)
    near_sums = cuda.shared.array(TAXELS, REAL)
    held = cuda.shared.array((2, BLOCK), REAL)
    row = cuda.shared.array(18, REAL)
    counts = cuda.shared.array(2, numba.int32)
    t = cuda.threadIdx.x
    block = cuda.blockIdx.x
    each = points.shape[1] // tiles.shape[1]
    taxels = image.shape[1]
    for k in range(block, force.shape[0], cuda.gridDim.x):
        cuda.syncthreads()
        if t < 18:
            row[t] = 0.0
        cuda.syncthreads()
        if t == 0:
            for i in range(3):
                row[i] = normals[k, i]
                row[3 + i] = origins[k, i] - middle[i]
            if turned:
                for i in range(9):
                    row[6 + i] = rotations[k, i]
        cuda.syncthreads()
        load = REAL(force[k] / elasticity)
        status = OK
        depth = 0.0
        sums = near_sums if taxels <= TAXELS else image[k]
        if is_unknown(row, load, turned):
            status = UNKNOWN
        elif load <= 0:
            status = NO_FORCE
        else:
            frame = frame_of(row, turned)
            normal = (frame[0], frame[1], frame[2])
            origin = (row[3], row[4], row[5])
            ax, ay, az, nearest, bend, reach = paraboloid(kind, size, frame)
            axis = (origin[0] + ax, origin[1] + ay, origin[2] + az)
            first = _nearest_tile(tiles, normal, axis, nearest, bend, reach, held, t)
            limit = FAR
            if first < FAR:
                limit = first + AHEAD * math.sqrt(2.0 * load * (bend + SKIN_BEND) / _PI)
            listed = near_listed if tiles.shape[1] <= TILES else far_listed[block]
            found = near_found
            which = near_which
            count = 0
            for attempt in range(_TRIES + 1):
                if attempt == _TRIES:
                    limit = FAR
                some = _list_tiles(tiles, normal, axis, nearest, bend, reach, limit, listed, counts, t)
                count = _gather(
                    kind, size, frame, origin, points, each, listed, some, limit, found, which, counts, t
                )
                if count > which.shape[0]:
                    found = far_found[block]
                    which = far_which[block]
                    count = _gather(
                        kind, size, frame, origin, points, each, listed, some, limit, found, which, counts, t
                    )
                if count == 0:
                    if limit == FAR:
                        break
                    limit = FAR
                    continue
                first = FAR
                for i in range(t, count, BLOCK):
                    first = min(first, found[0, i])
                first = _least(first, held, t)
                for i in range(t, count, BLOCK):
                    found[0, i] -= first
                depth = _depth(found, count, load, max(limit - first, 0.0), exponent, reference, held, t)
                if first + depth <= limit:
                    break
                limit = first + depth * _WIDER
            if count == 0:
                status = _untouched_status(points, frame, axis, counts, t)
            elif _sum_loads(
                found, which, count, depth, elasticity, exponent, reference, taxel, border, sums, counts, t
            ):
                status = AT_BORDER
            if depth > through:
                status = THROUGH_FINGER
        touched = status in (OK, AT_BORDER, THROUGH_FINGER)
        for j in range(t, taxels, BLOCK):
            value = sums[j] * scale[j] if touched else 0.0
            if status == UNKNOWN:
                image[k, j] = _NAN
            else:
                if whole:
                    value = REAL(round(value))
                image[k, j] = min(max(value, low), high)
        if t == 0:
            depths[k] = _NAN if status == UNKNOWN else depth
            statuses[k] = status
