"""Derivatives of loads: the equilibrium by the implicit function theorem, the distances by central differences."""

from __future__ import annotations

import numpy as np

from skincal.model.arrays import FloatArray, IntArray
from skincal.model.press.jit import device
from skincal.model.press.meet import FAR, Frame, meet
from skincal.model.press.routine import frame_of

_STEP_M, _STEP_RAD = 1e-6, 1e-5
"""Steps of the central differences of distances, which are smooth but for an indenter's rim: good to some 1e-9."""


@device
def moved(frame: Frame, wx: float, wy: float, wz: float) -> Frame:
    """The frame turned by a small rotation vector, to first order (the odd part of a central difference)."""
    return (
        frame[0] + wy * frame[2] - wz * frame[1],
        frame[1] + wz * frame[0] - wx * frame[2],
        frame[2] + wx * frame[1] - wy * frame[0],
        frame[3] + wy * frame[5] - wz * frame[4],
        frame[4] + wz * frame[3] - wx * frame[5],
        frame[5] + wx * frame[4] - wy * frame[3],
        frame[6] + wy * frame[8] - wz * frame[7],
        frame[7] + wz * frame[6] - wx * frame[8],
        frame[8] + wx * frame[7] - wy * frame[6],
        frame[9] + wy * frame[11] - wz * frame[10],
        frame[10] + wz * frame[9] - wx * frame[11],
        frame[11] + wx * frame[10] - wy * frame[9],
    )


@device
def look(
    kind: int,
    size: float,
    frame: Frame,
    origin: tuple[float, float, float],
    points: FloatArray,
    some: IntArray,
    field: FloatArray,
    step: float,
    place: FloatArray,
    out: FloatArray,
) -> None:
    """Distances, weights and facing of some points, moved along a field by a step, into ``out`` (3, n)."""
    count = some.shape[0]
    fields = field.shape[1] > 0
    for i in range(count):
        k = some[i]
        x, y, z, a, b, c = points[0, k], points[1, k], points[2, k], points[3, k], points[4, k], points[5, k]
        if fields:
            x, y, z = x + step * field[0, k], y + step * field[1, k], z + step * field[2, k]
            a, b, c = a + step * field[3, k], b + step * field[4, k], c + step * field[5, k]
        place[0, i], place[1, i], place[2, i] = x - origin[0], y - origin[1], z - origin[2]
        out[1, i] = a * frame[0] + b * frame[1] + c * frame[2]
    meet(kind, size, frame, place, count, out[0], out[2])


def slopes(
    points: FloatArray,
    taxel: IntArray,
    kind: int,
    size: float,
    rows: FloatArray,
    turned: bool,
    force: FloatArray,
    elasticity: float,
    exponent: float,
    reference: float,
    depth: FloatArray,
    starts: IntArray,
    carrying: IntArray,
    motions: FloatArray,
    fields: FloatArray,
    by_force: FloatArray,
    by_motion: FloatArray,
    by_field: FloatArray,
) -> None:
    """Derivatives of the loads of closed forms at presses that are settled.

    The points that carry are those that carry now: an image is smooth between the instants at which a point is met or
    left, and so is its derivative but for jumps that vanish with the size of the cells. Points that meet the indenter
    on one side of the difference only, at a rim, add nothing to it.

    Args:
        points: see :func:`skincal.model.press.routine.press`, as the following.
        taxel: the same.
        kind: the same.
        size: the same.
        rows: the same.
        turned: the same.
        force: the same.
        elasticity: the same.
        exponent: the same.
        reference: the same.
        depth: (K,) penetrations [m].
        starts: (K + 1,) where each press begins in ``carrying``.
        carrying: (n,) numbers of the points that carry.
        motions: (K, M, 6) velocities [m] and turns [rad] of the indenter, a unit of each parameter.
        fields: (G, 6, N) how positions and area vectors of points move, a unit of each parameter; or (0, 6, 0).
        by_force: (K, J) filled: by the logarithm of the force [N].
        by_motion: (K, M, J) filled [N].
        by_field: (K, G, J) filled [N].
    """
    most = 1
    for k in range(force.shape[0]):
        most = max(most, starts[k + 1] - starts[k])
    now, low, high = np.empty((3, most)), np.empty((3, most)), np.empty((3, most))
    place, rise, slope = np.empty((3, most)), np.empty(most), np.empty(most)
    still = np.empty((6, 0))
    for k in range(force.shape[0]):
        some = carrying[starts[k] : starts[k + 1]]
        count = some.shape[0]
        if count == 0:
            continue
        row = rows[k]
        frame = frame_of(row, turned)
        origin = (row[3], row[4], row[5])
        look(kind, size, frame, origin, points, some, still, 0.0, place, now)
        first = FAR
        for i in range(count):
            first = min(first, now[0, i])
        stiffness = 0.0
        for i in range(count):
            local = max(depth[k] - (now[0, i] - first), 0.0)
            rise[i], slope[i] = local, 1.0
            if exponent != 1.0:
                rise[i] = reference * (local / reference) ** exponent
                slope[i] = exponent * rise[i] / local if local > 0 else 0.0
            stiffness += now[1, i] * slope[i]
        for i in range(count):
            j = taxel[some[i]]
            if j >= 0:
                by_force[k, j] += slope[i] * now[1, i] * now[2, i] * force[k] / stiffness
        for m in range(motions.shape[1] + fields.shape[0]):
            if m < motions.shape[1]:
                v = motions[k, m]
                largest = max(abs(v[0]), max(abs(v[1]), abs(v[2]))) / _STEP_M
                largest = max(largest, max(abs(v[3]), max(abs(v[4]), abs(v[5]))) / _STEP_RAD)
                step = 1.0 / largest if largest > 0 else 1.0
                a = (origin[0] - step * v[0], origin[1] - step * v[1], origin[2] - step * v[2])
                b = (origin[0] + step * v[0], origin[1] + step * v[1], origin[2] + step * v[2])
                back, ahead = (
                    moved(frame, -step * v[3], -step * v[4], -step * v[5]),
                    moved(frame, step * v[3], step * v[4], step * v[5]),
                )
                look(kind, size, back, a, points, some, still, 0.0, place, low)
                look(kind, size, ahead, b, points, some, still, 0.0, place, high)
                out = by_motion[k, m]
            else:
                field = fields[m - motions.shape[1]]
                largest = 0.0
                for i in range(count):
                    for c in range(3):
                        largest = max(largest, abs(field[c, some[i]]))
                step = _STEP_M / largest if largest > 0 else 1.0
                look(kind, size, frame, origin, points, some, field, -step, place, low)
                look(kind, size, frame, origin, points, some, field, step, place, high)
                out = by_field[k, m - motions.shape[1]]
            shift = 0.0
            for i in range(count):
                met = low[0, i] < FAR and high[0, i] < FAR
                for c in range(3):
                    low[c, i] = (high[c, i] - low[c, i]) / (2.0 * step) if met else 0.0
                shift += now[1, i] * slope[i] * low[0, i] - low[1, i] * rise[i]
            shift /= stiffness
            for i in range(count):
                j = taxel[some[i]]
                if j >= 0:
                    deeper = slope[i] * (shift - low[0, i]) * now[1, i] * now[2, i]
                    out[j] += elasticity * (
                        deeper + rise[i] * (low[1, i] * now[2, i] + now[1, i] * low[2, i])
                    )
