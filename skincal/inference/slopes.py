"""Slopes of what all taxels read by many numbers, most of which move one taxel alone.

A parameter that each taxel has for itself (its level, its gain, whether it answers) makes a column a taxel, and on a
sensor of some hundred taxels these are nearly all there are. Such a column is kept as what its own taxel reads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Slopes:
    """n columns over K samples or observations, and J taxels.

    Attributes:
        dense: (K, J, d) columns in which any taxel may have a part.
        single: (K, s) columns of one taxel alone, at that taxel.
        taxel: (n,) taxel of each column; -1 for dense ones. Both kinds keep their order.
    """

    dense: FloatArray
    single: FloatArray
    taxel: IntArray

    @classmethod
    def of(cls, dense: FloatArray) -> Slopes:
        """Take columns (K, J, d) of all taxels."""
        return cls(dense, np.zeros((len(dense), 0)), np.full(dense.shape[2], -1))

    @classmethod
    def of_taxel(cls, column: FloatArray, taxel: int, taxels: int) -> Slopes:
        """Take one column (K,) of a taxel."""
        return cls(np.zeros((len(column), taxels, 0)), column[:, None], np.array([taxel]))

    @classmethod
    def joined(cls, parts: Sequence[Slopes]) -> Slopes:
        """Columns one after the other."""
        return cls(
            np.concatenate([p.dense for p in parts], axis=2),
            np.concatenate([p.single for p in parts], axis=1),
            np.concatenate([p.taxel for p in parts]),
        )

    def __len__(self) -> int:
        return len(self.taxel)

    @property
    def own(self) -> IntArray:
        """(s,) taxels of the single columns."""
        return self.taxel[self.taxel >= 0]

    def through(
        self, mean: Callable[[FloatArray], FloatArray], slope: FloatArray, weight: FloatArray
    ) -> Slopes:
        """Columns of observations: means over samples, behind a converter, over the noise.

        Args:
            mean: from samples (K, ...) to observations (N, ...).
            slope: (K, J) of the converter.
            weight: (N, J).
        """
        dense = mean(slope[..., None] * self.dense) * weight[..., None]
        return Slopes(dense, mean(slope[:, self.own] * self.single) * weight[:, self.own], self.taxel)

    def weighted(self, weight: FloatArray) -> Slopes:
        """Columns times (K, J)."""
        return Slopes(self.dense * weight[..., None], self.single * weight[:, self.own], self.taxel)

    def times(self, multiples: FloatArray) -> FloatArray:
        """(K, J) sum of columns, so many times each."""
        out = self.dense @ multiples[self.taxel < 0]
        np.add.at(out.T, self.own, (self.single * multiples[self.taxel >= 0]).T)
        return out

    def array(self) -> FloatArray:
        """(K, J, n) all of them, dense."""
        out = np.zeros((*self.dense.shape[:2], len(self)))
        out[..., self.taxel < 0] = self.dense
        out[:, self.own, np.flatnonzero(self.taxel >= 0)] = self.single
        return out

    @property
    def moves(self) -> bool:
        """Whether all are finite, and any is more than nothing."""
        return bool(
            np.isfinite(self.dense).all()
            and np.isfinite(self.single).all()
            and (self.dense.any() or self.single.any())
        )

    def slots(self) -> tuple[FloatArray, IntArray]:
        """Single columns taxel by taxel (K, J, m), and which of the m each is (s,)."""
        own = self.own
        order = np.argsort(own, kind="stable")
        count = np.bincount(own, minlength=self.dense.shape[1])
        slot = np.empty(len(own), dtype=np.int64)
        slot[order] = np.arange(len(own)) - (np.cumsum(count) - count)[own[order]]
        out = np.zeros((*self.dense.shape[:2], int(count.max(initial=0))))
        out[:, own, slot] = self.single
        return out, slot
