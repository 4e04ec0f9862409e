"""Cubic look-ups in a stack of planes, with derivatives, for very many points at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_TAPS = range(4)


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
    value: NDArray[np.float32] = np.zeros(plane.shape, dtype=np.float32)
    by_row: NDArray[np.float32] = np.zeros(len(row), dtype=np.float32)
    by_col: NDArray[np.float32] = np.zeros(len(row), dtype=np.float32)
    # Tap by tap, each for all points: four times as fast as point by point, each with all taps.
    for r in _TAPS:
        along: NDArray[np.float32] = np.zeros(plane.shape, dtype=np.float32)
        slope: NDArray[np.float32] = np.zeros(plane.shape, dtype=np.float32)
        for c in _TAPS:
            tap = np.asarray(flat[corner + (r * side + c)], dtype=np.float32)
            along += tap * col_weight[c]
            slope += tap * col_slope[c]
        value += row_weight[r] * along
        by_row += row_slope[r] * (share * along).sum(axis=0)
        by_col += row_weight[r] * (share * slope).sum(axis=0)
    return value, Looked((share * value).sum(axis=0), by_row, by_col)


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
