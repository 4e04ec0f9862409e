"""Hidden effects between taxels: a cover that spreads, crosstalk, ghosting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.blind.truth.body import ContactChange
from benchmarks.blind.truth.effect import Effect, Scene, Stage
from benchmarks.blind.truth.rig import COLS, ROWS, TAXELS, Floats


def neighbours() -> Floats:
    """1 for pairs of taxels that share an edge, else 0 (J, J)."""
    row, column = np.divmod(np.arange(TAXELS), COLS)
    apart = np.abs(row[:, None] - row) + np.abs(column[:, None] - column)
    return (apart == 1).astype(np.float64)


@dataclass(frozen=True)
class Spread(Effect):
    """A sheet with shear stiffness (Pasternak): felt pressure q with ``q - l² laplace(q) = p``. Strength l in mm."""

    name = "spread"
    typical = 0.5
    largest = 3.0

    def change(self) -> ContactChange:
        """See :meth:`Effect.change`."""
        return ContactChange(sheet_m=1e-3 * self.strength)


@dataclass(frozen=True)
class Crosstalk(Effect):
    """Taxels pick each other up through the air: ``y_j = x_j + c sum_k exp(-(d_jk - 1) / r) w_jk x_k``.

    d is the distance in pitches, across the corners too; w is 1 along a row and ``columns`` along a column, with what
    lies between for other directions, as wires lie closer one way. Strength c.
    """

    range_pitches: float = 0.4
    columns: float = 1.0

    name = "crosstalk"
    stage = Stage.COUPLING
    typical = 0.05

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical, float(rng.uniform(0.2, 0.6)), float(rng.uniform(0.5, 1.5)))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        del scene
        row, column = np.divmod(np.arange(TAXELS), COLS)
        up, aside = row[:, None] - row, column[:, None] - column
        apart = np.hypot(up, aside)
        away = np.where(apart > 0, apart, np.inf)
        wires = (aside**2 + self.columns * up**2) / away**2
        return x + self.strength * x @ (np.exp(-(away - 1) / self.range_pitches) * wires)


@dataclass(frozen=True)
class Ghosting(Effect):
    """A matrix of resistors read line by line; lines that are not read are held at ground through a resistance.

    Reading (i, j) drives row i and measures the current out of column j. ``strength`` is the conductance of an
    unloaded taxel over that which holds an idle line; without it, idle lines are at ground and nothing leaks.
    """

    rest_counts: float = 80.0

    name = "ghosting"
    stage = Stage.COUPLING
    typical = 0.3

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Effect:
        """See :meth:`Effect.draw`."""
        return cls(cls.typical, float(rng.uniform(50, 150)))

    def signal(self, x: Floats, scene: Scene) -> Floats:
        """See :meth:`Effect.signal`."""
        del scene
        busy = np.flatnonzero(x.max(axis=1) > 0)
        y = x.copy()
        y[busy] = self._read(self.rest_counts + x[busy]) - self._read(np.full((1, TAXELS), self.rest_counts))
        return y

    def _read(self, conductance: Floats) -> Floats:
        g = conductance.reshape(-1, ROWS, COLS)
        hold = self.rest_counts / max(self.strength, 1e-9)
        found = np.empty_like(g)
        for i in range(ROWS):
            for j in range(COLS):
                found[:, i, j] = _current(g, i, j, hold)
        return found.reshape(-1, TAXELS)


def _current(g: Floats, i: int, j: int, hold: float) -> Floats:
    """Current out of column j, held at zero, with row i at one volt (K,)."""
    rows, columns = np.delete(np.arange(ROWS), i), np.delete(np.arange(COLS), j)
    inner = g[:, rows][:, :, columns]
    out_of_row = g[:, rows].sum(axis=2) + hold
    out_of_column = g[:, :, columns].sum(axis=1) + hold
    # Columns in terms of rows, then the idle rows alone.
    fed = g[:, i][:, columns] / out_of_column
    matrix = np.einsum("kl,lm->klm", out_of_row, np.eye(len(rows)))
    matrix -= np.einsum("klc,kmc->klm", inner / out_of_column[:, None], inner)
    volts = np.linalg.solve(matrix, np.einsum("klc,kc->kl", inner, fed)[:, :, None])[:, :, 0]
    return g[:, i, j] + (volts * g[:, rows, j]).sum(axis=1)
