"""Lattices of positions, and minima on them."""

from __future__ import annotations

import numpy as np

from skincal.fitting.types import Bools, Floats, Ints


def square(axis: Floats) -> Floats:
    """Return the points (N², 2) of a square lattice with the same values (N,) along both axes."""
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)


def disc(step: float, reach: float) -> Floats:
    """Return the points (N, 2) of a square lattice, with a node at 0, within a distance ``reach`` of it."""
    half = int(np.ceil(reach / step))
    lattice = square(np.arange(-half, half + 1, dtype=np.float64) * step)
    return lattice[np.hypot(lattice[:, 0], lattice[:, 1]) <= reach]


def minima(values: Floats) -> Bools:
    """Return the nodes of square lattices (K, N, N) that are no higher than any of their eight neighbours."""
    side = values.shape[1]
    padded = np.pad(values, ((0, 0), (1, 1), (1, 1)), constant_values=np.inf)
    around = [padded[:, i : i + side, j : j + side] for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    return values <= np.min(around, axis=0)


def best_of_each(press: Ints, score: Floats, count: int) -> Ints:
    """Return the number of the position (of N) with the lowest score (N,) for each of ``count`` presses.

    Every press needs at least one position.
    """
    order = np.lexsort((score, press))
    return order[np.searchsorted(press[order], np.arange(count))]
