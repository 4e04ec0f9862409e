"""The kinematics of one posture as compiled loops: for so few numbers numpy takes many times longer.

A chain is passed as the arrays of :class:`skincal.robot.chain.Chain` in the order of its attributes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numpy as np

from skincal.model.arrays import FloatArray
from skincal.model.press.jit import cached, reporting_compilation

Frame = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Rotation (3, 3), origin (3,), axes (J, 3) and pivots (J, 3) of one tip, as in TipFrames."""

SOUND, SINGULAR = 0, 1
"""Statuses of a contact."""

_SINGULAR = 1e6
"""Largest bound of the condition number of the normal equations for the force."""
_ROUNDS = 100
_DAMPING = 1e-4
"""Damping, relative to the mean eigenvalue of J J^T: it keeps steps short near a singular posture."""
_FADE_M = 1e-3
"""Error below which the damping fades [m], so that the last iterations are plain Newton steps."""
_LONGEST_RAD = 0.2
"""Largest change of a joint per iteration [rad]."""
_SETTINGS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
_CALLED: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, **_SETTINGS}
_Function = TypeVar("_Function", bound=Callable[..., Any])


def called(function: _Function) -> _Function:
    """Compile a function that only compiled functions call; inlining it would take several times as long to compile."""
    return cast(_Function, numba.njit(**_CALLED)(function))


@called
def turn(rotation: FloatArray, by: FloatArray) -> None:  # pragma: no cover - compiled
    """Multiply a rotation (3, 3) by another from the right."""
    for i in range(3):
        x, y, z = rotation[i, 0], rotation[i, 1], rotation[i, 2]
        for k in range(3):
            rotation[i, k] = x * by[0, k] + y * by[1, k] + z * by[2, k]


@called
def dot(matrix: FloatArray, i: int, x: float, y: float, z: float) -> float:  # pragma: no cover - compiled
    """Return the product of a matrix' row (3,) with a vector."""
    return matrix[i, 0] * x + matrix[i, 1] * y + matrix[i, 2] * z


@called
def new_frame(chain: Any) -> Any:  # pragma: no cover - compiled
    """Return arrays for the frame of a chain's tip."""
    joints = len(chain[0])
    return np.empty((3, 3)), np.empty(3), np.empty((joints, 3)), np.empty((joints, 3))


@called
def place_tip(q: FloatArray, chain: Any, frame: Any) -> None:  # pragma: no cover - compiled
    """Write the frame of a chain's tip at angles (n,) [rad] of the whole hand."""
    columns, steps, constant, sine, cosine, directions, slides, end_rotation, end = chain
    rotation, origin, axes, pivots = frame
    by = np.empty((3, 3))
    for i in range(3):
        origin[i] = 0.0
        for k in range(3):
            rotation[i, k] = 1.0 if i == k else 0.0
    for j in range(len(columns)):
        angle = q[columns[j]]
        moved = angle if slides[j] else 0.0
        for i in range(3):
            axes[j, i] = dot(rotation, i, directions[j, 0], directions[j, 1], directions[j, 2])
            origin[i] += dot(rotation, i, steps[j, 0], steps[j, 1], steps[j, 2]) + moved * axes[j, i]
            pivots[j, i] = origin[i]
        sin, cos = math.sin(angle), math.cos(angle)
        for i in range(3):
            for k in range(3):
                by[i, k] = constant[j, i, k] + sin * sine[j, i, k] + cos * cosine[j, i, k]
        turn(rotation, by)
    for i in range(3):
        origin[i] += dot(rotation, i, end[0], end[1], end[2])
    turn(rotation, end_rotation)


@called
def velocity(
    frame: Any, slides: Any, j: int, point: FloatArray
) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """Return the velocity of a point (3,) of a tip per velocity of its joint j [m/rad]."""
    axes, pivots = frame[2], frame[3]
    x, y, z = axes[j, 0], axes[j, 1], axes[j, 2]
    if slides[j]:
        return x, y, z
    a, b, c = point[0] - pivots[j, 0], point[1] - pivots[j, 1], point[2] - pivots[j, 2]
    return y * c - z * b, z * a - x * c, x * b - y * a


@called
def add_joints(
    frame: Any,
    slides: Any,
    point: FloatArray,
    values: FloatArray,
    sign: float,
    square: FloatArray,
    right: Any,
) -> None:  # pragma: no cover - compiled
    """Add J J^T to a matrix (3, 3) and J times values (J,) to a vector (3,), J of a point (3,) of a tip."""
    for j in range(len(slides)):
        column = velocity(frame, slides, j, point)
        for i in range(3):
            right[i] += sign * column[i] * values[j]
            for k in range(3):
                square[i, k] += column[i] * column[k]


@called
def invert(a: FloatArray, out: FloatArray) -> bool:  # pragma: no cover - compiled
    """Write the inverse of a symmetric matrix (3, 3); return False where rounding leaves none."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for m in range(3):
            n, p = (m + 1) % 3, (m + 2) % 3
            out[m, i] = a[j, n] * a[k, p] - a[j, p] * a[k, n]
    determinant = a[0, 0] * out[0, 0] + a[0, 1] * out[1, 0] + a[0, 2] * out[2, 0]
    if determinant == 0.0:
        return False
    for i in range(3):
        for m in range(3):
            out[i, m] /= determinant
    return True


@called
def damped_step(
    frame: Any, slides: Any, free: FloatArray, error: FloatArray, distance: float, step: FloatArray
) -> None:  # pragma: no cover - compiled
    """Write a damped Newton step (J,) of the free joints that moves the tip's origin by an error (3,)."""
    square, inverse, pull = np.zeros((3, 3)), np.empty((3, 3)), np.empty(3)
    for j in range(len(free)):
        column = velocity(frame, slides, j, frame[1])
        for i in range(3):
            for k in range(3):
                square[i, k] += free[j] * column[i] * column[k]
    damping = _DAMPING * (min(1.0, distance / _FADE_M) + 1e-6)
    damping *= (square[0, 0] + square[1, 1] + square[2, 2]) / 3
    for i in range(3):
        square[i, i] += damping
    invert(square, inverse)
    for i in range(3):
        pull[i] = dot(inverse, i, error[0], error[1], error[2])
    for j in range(len(free)):
        x, y, z = velocity(frame, slides, j, frame[1])
        step[j] = free[j] * (x * pull[0] + y * pull[1] + z * pull[2])


def tip_frames(q: FloatArray, chain: Any, rotations: Any, origins: Any, axes: Any, pivots: Any) -> None:
    """Write the frames of a chain's tip at K sets of angles (K, n) [rad]: see TipFrames."""
    for k in range(len(q)):
        place_tip(q[k], chain, (rotations[k], origins[k], axes[k], pivots[k]))


def contacts(
    q: FloatArray,
    tau: FloatArray,
    give: FloatArray,
    skin: Any,
    indenter: Any,
    arc_radius_m: float,
    out: FloatArray,
) -> int:
    """Write K contacts in rows: point, normal and centre (3 each), the centre's height, force, shear along u and v."""
    on, off = new_frame(skin), new_frame(indenter)
    centre, at, normal, inverse = np.empty(3), np.empty(3), np.empty(3), np.empty((3, 3))
    links, torques = np.empty(q.shape[1]), np.empty(q.shape[1])
    status = SOUND
    for k in range(len(q)):
        for j in range(q.shape[1]):
            links[j] = q[k, j] - (give[j] * tau[k, j] if math.isfinite(tau[k, j]) else 0.0)
        place_tip(links, skin, on)
        place_tip(links, indenter, off)
        x, y, z = off[1][0] - on[1][0], off[1][1] - on[1][1], off[1][2] - on[1][2]
        for i in range(3):
            centre[i] = on[0][0, i] * x + on[0][1, i] * y + on[0][2, i] * z
        normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
        at[0], at[1], at[2] = centre[0], centre[1], 0.0
        if math.isfinite(arc_radius_m):
            beta = math.atan2(centre[0], centre[2])
            normal[0], normal[2] = math.sin(beta), math.cos(beta)
            at[0], at[2] = arc_radius_m * normal[0], arc_radius_m * normal[2]
        row = out[k]
        row[9] = 0.0
        for i in range(3):
            row[i], row[3 + i], row[6 + i] = at[i], normal[i], centre[i]
            row[9] += (centre[i] - at[i]) * normal[i]
        x, y, z = at[0], at[1], at[2]
        for i in range(3):
            at[i] = on[1][i] + dot(on[0], i, x, y, z)
        # Least squares of both fingers' torques: J J^T F = J tau.
        square, right = np.zeros((3, 3)), np.zeros(3)
        for j in range(len(indenter[0])):
            torques[j] = tau[k, indenter[0][j]]
        add_joints(off, indenter[6], at, torques, 1.0, square, right)
        for j in range(len(skin[0])):
            torques[j] = tau[k, skin[0][j]]
        add_joints(on, skin[6], at, torques, -1.0, square, right)
        row[10] = row[11] = row[12] = math.nan
        trace = square[0, 0] + square[1, 1] + square[2, 2]
        if not math.isfinite(trace):
            continue
        # For eigenvalues l of a positive matrix, sum l times sum 1 / l bounds the ratio of the largest to the smallest.
        # Rounding may give a singular matrix a negative eigenvalue.
        known = invert(square, inverse)
        if not (known and 0.0 < trace * (inverse[0, 0] + inverse[1, 1] + inverse[2, 2]) <= _SINGULAR):
            status = SINGULAR
            continue
        x, y, z = (
            dot(inverse, 0, right[0], right[1], right[2]),
            dot(inverse, 1, right[0], right[1], right[2]),
            dot(inverse, 2, right[0], right[1], right[2]),
        )
        for i in range(3):
            at[i] = on[0][0, i] * x + on[0][1, i] * y + on[0][2, i] * z
        row[10] = -(at[0] * normal[0] + at[2] * normal[2])
        row[11] = at[0] * normal[2] - at[2] * normal[0]
        row[12] = at[1]
    return status


def reach(
    q: FloatArray, goal: FloatArray, chain: Any, low: FloatArray, high: FloatArray, near: float
) -> float:
    """Move a chain's joints in angles (n,) until its tip is near a goal (3,); return the least distance [m]."""
    columns, slides = chain[0], chain[6]
    frame, joints = new_frame(chain), len(columns)
    step, free = np.empty(joints), np.empty(joints)
    error, best = np.empty(3), math.inf
    for _ in range(_ROUNDS):
        place_tip(q, chain, frame)
        for i in range(3):
            error[i] = goal[i] - frame[1][i]
        distance = math.sqrt(error[0] * error[0] + error[1] * error[1] + error[2] * error[2])
        best = min(best, distance)
        if best <= near:
            break
        for j in range(joints):
            free[j] = 1.0
        damped_step(frame, slides, free, error, distance, step)
        held = 0
        for j in range(joints):
            angle = q[columns[j]]
            if (angle <= low[j] and step[j] < 0) or (angle >= high[j] and step[j] > 0):
                free[j] = 0.0
                held += 1
        if 0 < held < joints:
            damped_step(frame, slides, free, error, distance, step)
        longest = 1e-12
        for j in range(joints):
            longest = max(longest, abs(step[j]))
        share = min(1.0, _LONGEST_RAD / longest)
        for j in range(joints):
            q[columns[j]] = min(max(q[columns[j]] + share * step[j], low[j]), high[j])
    return best


class Routine(NamedTuple):
    """The entry points."""

    tip_frames: Any
    contacts: Any
    reach: Any


@cache
def compiled() -> Routine:
    """Compile the entry points, or load them."""
    with reporting_compilation():
        return Routine(*(cached(one, one.__name__, _SETTINGS) for one in (tip_frames, contacts, reach)))
