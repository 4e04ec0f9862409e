"""Slopes of the readings of all taxels by many parameters, most of which change one taxel alone.

A per-taxel parameter (offset, gain, dead or not) makes one column for each taxel; on a sensor with hundreds of taxels
these are nearly all columns. Such a column is stored at its own taxel only.
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
        dense: (K, J, d) columns that may change any taxel.
        single: (K, s) columns of one taxel each, at that taxel.
        taxel: (n,) taxel of each column, -1 for dense ones. Both kinds keep their order.
    """

    dense: FloatArray
    single: FloatArray
    taxel: IntArray

    @classmethod
    def of(cls, dense: FloatArray) -> Slopes:
        """Make dense columns (K, J, d)."""
        return cls(dense, np.zeros((len(dense), 0)), np.full(dense.shape[2], -1))

    @classmethod
    def of_taxel(cls, column: FloatArray, taxel: int, taxels: int) -> Slopes:
        """Make one column (K,) of a taxel."""
        return cls(np.zeros((len(column), taxels, 0)), column[:, None], np.array([taxel]))

    @classmethod
    def joined(cls, parts: Sequence[Slopes]) -> Slopes:
        """Concatenate columns."""
        return cls(
            np.concatenate([p.dense for p in parts], axis=2),
            np.concatenate([p.single for p in parts], axis=1),
            np.concatenate([p.taxel for p in parts]),
        )

    def __len__(self) -> int:
        return len(self.taxel)

    @property
    def own(self) -> IntArray:
        """Taxels (s,) of the single columns."""
        return self.taxel[self.taxel >= 0]

    def through(
        self, mean: Callable[[FloatArray], FloatArray], slope: FloatArray, weight: FloatArray
    ) -> Slopes:
        """Map slopes of samples to whitened slopes of observations.

        Args:
            mean: averages samples (K, ...) to observations (N, ...).
            slope: (K, J) of the converter.
            weight: (N, J) robust weight over the noise.
        """
        dense = mean(slope[..., None] * self.dense) * weight[..., None]
        return Slopes(dense, mean(slope[:, self.own] * self.single) * weight[:, self.own], self.taxel)

    def weighted(self, weight: FloatArray) -> Slopes:
        """Multiply all columns by (K, J)."""
        return Slopes(self.dense * weight[..., None], self.single * weight[:, self.own], self.taxel)

    def times(self, multiples: FloatArray) -> FloatArray:
        """Return the sum (K, J) of columns times multiples (n,)."""
        out = self.dense @ multiples[self.taxel < 0]
        single, own = multiples[self.taxel >= 0], self.own
        for j in np.unique(own):
            out[:, j] += self.single[:, own == j] @ single[own == j]
        return out

    def array(self) -> FloatArray:
        """Return all columns, dense (K, J, n)."""
        out = np.zeros((*self.dense.shape[:2], len(self)))
        out[..., self.taxel < 0] = self.dense
        out[:, self.own, np.flatnonzero(self.taxel >= 0)] = self.single
        return out

    @property
    def moves(self) -> bool:
        """True if all columns are finite and any is not zero."""
        return bool(
            np.isfinite(self.dense).all()
            and np.isfinite(self.single).all()
            and (self.dense.any() or self.single.any())
        )

    def slots(self) -> tuple[FloatArray, IntArray]:
        """Arrange single columns by taxel (K, J, m), and return the index of each among those of its taxel (s,)."""
        own = self.own
        order = np.argsort(own, kind="stable")
        count = np.bincount(own, minlength=self.dense.shape[1])
        slot = np.empty(len(own), dtype=np.int64)
        slot[order] = np.arange(len(own)) - (np.cumsum(count) - count)[own[order]]
        out = np.zeros((*self.dense.shape[:2], int(count.max(initial=0))))
        out[:, own, slot] = self.single
        return out, slot
