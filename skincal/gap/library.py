"""Linearised sensitivities of all effects about one fitted session, shared by data and by all null sessions.

A column is the secant of the values from neutral to a quarter of a typical strength, one for each number and each form
of an effect. With the priors of the numbers, what an effect explains of residuals r on the presses learned from (L) and
on those that score (S) is, with A the whitened and projected columns,

    x = (A_L' A_L + prior^-2)^-1 A_L' r_L,      learned = 2 x' A_L' r_L - |A_L x|²,    scored = 2 x' A_S' r_S - |A_S x|²
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skincal.effects import EFFECTS
from skincal.gap.candidates import Scene, Start, View, secants
from skincal.gap.free import priors, strengths
from skincal.model.arrays import BoolArray, FloatArray, IntArray

Pair = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class Library:
    """Columns of effects.

    Attributes:
        columns: of each effect the starts of its search, and the change of the values (N, J, n) by each strength
            there [counts].
    """

    columns: Mapping[str, tuple[tuple[Start, FloatArray], ...]]

    @classmethod
    def of(cls, scene: Scene, names: Sequence[str] | None = None) -> Library:
        """Columns of all effects that the data can speak of, or of some."""
        found = {
            name: tuple((start, columns_of(scene, start)) for start in scene.bench.starts(name))
            for name in names or EFFECTS
        }
        return cls({name: own for name, own in found.items() if own})

    def falls(self, name: str, views: tuple[View, View], residuals: Pair) -> Pair:
        """What an effect's best form explains (D,) of the presses learned from, and of those that score.

        Which form is best is told as :func:`skincal.gap.candidates.best_of` tells it.

        Args:
            name: of the effect.
            views: of the presses learned from and of those that score.
            residuals: (n J, D) each, whitened and projected.
        """
        found = [_falls(start, columns, views, residuals) for start, columns in self.columns[name]]
        learned, scored = (np.stack([f[i] for f in found]) for i in (0, 1))
        best: IntArray = np.argmax(learned, axis=0)[None]
        lost: BoolArray = np.take_along_axis(scored, best, 0) <= 0
        best[lost] = np.argmax(scored, axis=0)[None][lost]
        return np.take_along_axis(learned, best, 0)[0], np.take_along_axis(scored, best, 0)[0]


def _falls(start: Start, columns: FloatArray, views: tuple[View, View], residuals: Pair) -> Pair:
    penalty = np.diag(1 / priors(start.coords)[strengths(start.coords)] ** 2)
    first, second = (view.seen(columns) for view in views)
    x = np.linalg.solve(first.T @ first + penalty, first.T @ residuals[0])

    def fall(seen: FloatArray, of: FloatArray) -> FloatArray:
        return 2 * ((seen.T @ of) * x).sum(axis=0) - ((seen @ x) ** 2).sum(axis=0)

    return fall(first, residuals[0]), fall(second, residuals[1])


def columns_of(scene: Scene, start: Start) -> FloatArray:
    """Change of the values (N, J, n) by each strength of an effect, a secant from neutral [counts]."""
    return secants(scene, start, np.flatnonzero(strengths(start.coords)))
