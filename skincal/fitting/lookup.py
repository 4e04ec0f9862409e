"""Cubic look-ups in a stack of planes, with derivatives, for very many points at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Looked:
    """Values and derivatives of a look-up, each (n,), per lattice step."""

    value: NDArray[np.float32]
    by_row: NDArray[np.float32]
    by_col: NDArray[np.float32]


def cubic(
    planes: NDArray[np.float32], plane: NDArray[np.intp], row: NDArray[np.float32], col: NDArray[np.float32]
) -> Looked:
    """Interpolates with the cubic convolution of Keys (1981, a = -1/2): exact for quadratics, continuous slope.

    Args:
        planes: (P, N, N) stack of planes whose two outer rows and columns are zero.
        plane: (n,) which plane.
        row: (n,) position along the first axis of the plane, in lattice steps; clamped to the plane.
        col: (n,) position along the second axis.

    Returns:
        Values and their derivatives along both axes.
    """
    return cubic_mixed(planes, plane[None], np.ones((1, len(plane)), dtype=np.float32), row, col)[1]


def cubic_mixed(
    planes: NDArray[np.float32],
    plane: NDArray[np.intp],
    share: NDArray[np.float32],
    row: NDArray[np.float32],
    col: NDArray[np.float32],
) -> tuple[NDArray[np.float32], Looked]:
    """Looks up k planes at the same positions, and their weighted sum.

    Args:
        planes: as for :func:`cubic`.
        plane: (k, n) which planes.
        share: (k, n) how much each counts in the sum.
        row: (n,) position along the first axis.
        col: (n,) position along the second axis.

    Returns:
        Value of each plane (k, n), and the sum with its derivatives.
    """
    side, flat = planes.shape[1], planes.reshape(-1)
    row_low, row_weight, row_slope = keys_weights(row, side)
    col_low, col_weight, col_slope = keys_weights(col, side)
    corner = (plane * side + (row_low - 1)) * side + (col_low - 1)
    value: NDArray[np.float32] = np.empty(plane.shape, dtype=np.float32)
    sums: NDArray[np.float32] = np.zeros((3, len(row)), dtype=np.float32)
    _add_taps(flat, corner, side, share, row_weight, row_slope, col_weight, col_slope, value, sums)
    return value, Looked(sums[0], sums[1], sums[2])


@njit(cache=True, fastmath=False)
def _add_taps(  # pragma: no cover - compiled
    flat: Any,
    corner: Any,
    side: int,
    share: Any,
    row_weight: Any,
    row_slope: Any,
    col_weight: Any,
    col_slope: Any,
    value: Any,
    sums: Any,
) -> None:
    """Sum the 16 taps of each look-up: ``value`` (k, n) of each plane, ``sums`` (3, n) mixed with their slopes."""
    planes, count = corner.shape
    for i in range(count):
        for k in range(planes):
            total = by_row = by_col = np.float32(0.0)
            for r in range(4):
                along = slope = np.float32(0.0)
                at = corner[k, i] + r * side
                for c in range(4):
                    tap = flat[at + c]
                    along += tap * col_weight[c, i]
                    slope += tap * col_slope[c, i]
                total += row_weight[r, i] * along
                by_row += row_slope[r, i] * along
                by_col += row_weight[r, i] * slope
            value[k, i] = total
            sums[0, i] += share[k, i] * total
            sums[1, i] += share[k, i] * by_row
            sums[2, i] += share[k, i] * by_col


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
