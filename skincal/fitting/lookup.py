"""Cubic look-ups in stacks of planes, with derivatives: the cubic convolution of Keys (1981, a = -1/2), compiled.

It is exact for quadratics and has a continuous slope. Values are single precision, as the tables are; sums of them are
double.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """Compile a function of the fit; the compilation is cached for all processes after the first."""
    return cast(_Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


@compiled
def keys(at: float, side: int) -> Any:  # pragma: no cover - compiled
    """First of the four taps round a position, how much each counts, and the derivatives of that."""
    at = min(max(at, 1.0), side - 2.001)
    low = int(at)
    t = at - low
    weight = (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )
    slope = (
        (-1.5 * t + 2.0) * t - 0.5,
        (4.5 * t - 5.0) * t,
        (-4.5 * t + 4.0) * t + 0.5,
        (1.5 * t - 1.0) * t,
    )
    return low - 1, weight, slope


@compiled
def taps(plane: Any, rows: Any, cols: Any) -> Any:  # pragma: no cover - compiled
    """Value of a plane (N, N) and its derivatives along both axes, for what :func:`keys` says of a row and a column."""
    r0, rw, rs = rows
    c0, cw, cs = cols
    value = by_row = by_col = 0.0
    for r in range(4):
        along = slope = 0.0
        for c in range(4):
            tap = plane[r0 + r, c0 + c]
            along += tap * cw[c]
            slope += tap * cs[c]
        value += rw[r] * along
        by_row += rs[r] * along
        by_col += rw[r] * slope
    return value, by_row, by_col


@compiled
def cubic(planes: Any, plane: Any, row: Any, col: Any) -> Any:  # pragma: no cover - compiled
    """Look up values.

    Args:
        planes: (P, N, N) stack of planes.
        plane: (n,) which plane.
        row: (n,) position along the first axis of the plane, in lattice steps; clamped to the plane.
        col: (n,) position along the second axis.

    Returns:
        (3, n) values, and their derivatives along both axes per lattice step.
    """
    out = np.empty((3, len(plane)))
    side = planes.shape[1]
    for i in range(len(plane)):
        out[0, i], out[1, i], out[2, i] = taps(planes[plane[i]], keys(row[i], side), keys(col[i], side))
    return out


@compiled
def at_level(
    planes: Any, size_of: Any, centres: Any, lattice: Any, u: float, v: float, press: int, out: Any
) -> None:  # pragma: no cover - compiled
    """Fill ``out`` (3, J) with the load shares of all taxels under one contact, and their slopes by u and v [1/m].

    Args:
        planes: (K, M, N, N) load shares of presses, by taxel size.
        size_of: (J,) which size each taxel has.
        centres: (J, 2) of the taxels [m].
        lattice: step and half the width of the planes [m].
        u: contact in patch coordinates [m].
        v: the same.
        press: which.
        out: filled.
    """
    step, half = lattice
    reach, side = half - 1.5 * step, planes.shape[2]
    for j in range(len(centres)):
        du, dv = u - centres[j, 0], v - centres[j, 1]
        if abs(du) < reach and abs(dv) < reach:
            value, by_row, by_col = taps(
                planes[press, size_of[j]], keys((du + half) / step, side), keys((dv + half) / step, side)
            )
            out[0, j], out[1, j], out[2, j] = value, by_row / step, by_col / step
        else:
            out[0, j] = out[1, j] = out[2, j] = 0.0


@compiled
def mixed(
    shares: Any, size_of: Any, centres: Any, lattice: Any, uv: Any, kind: Any, turn: Any, ratio: Any, out: Any
) -> None:  # pragma: no cover - compiled
    """Fill ``out`` (5, n, J): load shares, and their slopes by u, v, turn and log(F/E).

    Args:
        shares: (I, M, A, L, N, N) as in a kernel table.
        size_of: (J,) which size each taxel has.
        centres: (J, 2) of the taxels [m].
        lattice: step and half the width of the planes [m].
        uv: (n, 2) contacts in patch coordinates [m].
        kind: (n,) indenter.
        turn: (n,) tabled turn below, (n,) part of the step above it, and the step [rad].
        ratio: the same of log(F/E).
        out: zeros.
    """
    step, half = lattice
    reach, side = half - 1.5 * step, shares.shape[4]
    a_low, a_part, a_step = turn
    r_low, r_part, r_step = ratio
    turns = 2 if shares.shape[2] > 1 else 1
    for i in range(len(uv)):
        a, r = a_low[i], r_low[i]
        wa, wr = a_part[i], r_part[i]
        for j in range(len(centres)):
            du, dv = uv[i, 0] - centres[j, 0], uv[i, 1] - centres[j, 1]
            if not (abs(du) < reach and abs(dv) < reach):
                continue
            rows, cols = keys((du + half) / step, side), keys((dv + half) / step, side)
            for over in range(turns):
                tables = shares[kind[i], size_of[j], a + over]
                below, below_u, below_v = taps(tables[r], rows, cols)
                above, above_u, above_v = taps(tables[r + 1], rows, cols)
                part = wa if over else 1.0 - wa
                value = (1.0 - wr) * below + wr * above
                out[0, i, j] += part * value
                out[1, i, j] += part * ((1.0 - wr) * below_u + wr * above_u) / step
                out[2, i, j] += part * ((1.0 - wr) * below_v + wr * above_v) / step
                out[4, i, j] += part * (above - below) / r_step
                if turns > 1:
                    out[3, i, j] += (value if over else -value) / a_step


def keys_weights(
    at: NDArray[np.float32], side: int
) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
    """The four taps round each position and how much each counts.

    Args:
        at: (n,) positions on a line of nodes; clamped to where all four taps are.
        side: number of nodes.

    Returns:
        Node below each position (n,), of which taps begin one before; weights and their derivatives (4, n).
    """
    at = np.clip(at, 1.0, side - 2.001)
    low = at.astype(np.intp)
    t = (at - low).astype(np.float32)
    weight = np.empty((4, len(at)), dtype=np.float32)
    weight[0] = ((-0.5 * t + 1.0) * t - 0.5) * t
    weight[1] = (1.5 * t - 2.5) * t * t + 1.0
    weight[2] = ((-1.5 * t + 2.0) * t + 0.5) * t
    weight[3] = (0.5 * t - 0.5) * t * t
    slope = np.empty_like(weight)
    slope[0] = (-1.5 * t + 2.0) * t - 0.5
    slope[1] = (4.5 * t - 5.0) * t
    slope[2] = (-4.5 * t + 4.0) * t + 0.5
    slope[3] = (1.5 * t - 1.0) * t
    return low, weight, slope
