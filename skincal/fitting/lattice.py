"""Lattices of places, and what is least on them."""

from __future__ import annotations

import numpy as np

from skincal.fitting.types import Bools, Floats, Ints


def square(axis: Floats) -> Floats:
    """Return the points (N², 2) of a square lattice with the same values (N,) along both axes."""
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)


def disc(step: float, reach: float) -> Floats:
    """Return the points (N, 2) of a square lattice with a node at 0 that lie no further off than ``reach``."""
    half = int(np.ceil(reach / step))
    lattice = square(np.arange(-half, half + 1, dtype=np.float64) * step)
    return lattice[np.hypot(lattice[:, 0], lattice[:, 1]) <= reach]


def minima(values: Floats) -> Bools:
    """Return the nodes of square lattices (K, N, N) that are above none of their eight neighbours."""
    side = values.shape[1]
    padded = np.pad(values, ((0, 0), (1, 1), (1, 1)), constant_values=np.inf)
    around = [padded[:, i : i + side, j : j + side] for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    return values <= np.min(around, axis=0)


def best_of_each(press: Ints, score: Floats, count: int) -> Ints:
    """Return for each of ``count`` presses the place (of N) whose score (N,) is least; every press has one."""
    order = np.lexsort((score, press))
    return order[np.searchsorted(press[order], np.arange(count))]
