"""Positions and sizes of the taxels in patch coordinates (u, v)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skincal.errors import first_of
from skincal.model.arrays import FloatArray, IntArray, floats

Pair = float | tuple[float, float]
"""One length [m] for both directions, or one for u and one for v."""

MOST_NAMED = 8
"""Most taxels that a text lists."""


@dataclass(frozen=True, eq=False)
class TaxelLayout:
    """Taxels as rectangles on the patch, ``j = r * cols + c`` (the sets T_j of the paper, equation 2).

    ``c`` grows with u and ``r`` with v. Use :meth:`grid` for a regular layout, the constructor for any other.

    Attributes:
        rows: rows of the image.
        cols: columns of the image.
        centres_m: (J, 2) centres (u, v) [m], J = rows * cols.
        sizes_m: (J, 2) edge lengths along u and v [m]; one pair (2,) stands for all.
    """

    rows: int
    cols: int
    centres_m: FloatArray
    sizes_m: FloatArray

    def __post_init__(self) -> None:
        if self.rows < 1 or self.cols < 1:
            raise ValueError(
                f"layout: expected at least one row and one column; got {self.rows} x {self.cols}"
            )
        taxels = self.rows * self.cols
        sizes = np.broadcast_to(np.asarray(self.sizes_m, dtype=np.float64), (taxels, 2))
        object.__setattr__(self, "centres_m", floats("layout centres_m", self.centres_m, (taxels, 2)))
        object.__setattr__(self, "sizes_m", floats("layout sizes_m", sizes, (taxels, 2)))
        if np.any(self.sizes_m <= 0):
            raise ValueError(f"layout sizes_m: expected lengths > 0; got {self.sizes_m.min():.6g}")
        self._check_apart()

    @classmethod
    def grid(cls, rows: int, cols: int, *, taxel_size_m: Pair, pitch_m: Pair) -> TaxelLayout:
        """Return a regular grid, centred on the patch.

        Args:
            rows: number of rows.
            cols: number of columns.
            taxel_size_m: edge lengths of a taxel [m].
            pitch_m: distance of neighbouring centres [m].

        Raises:
            ValueError: no taxels, lengths that are not positive, or taxels that overlap.
        """
        pitch = np.broadcast_to(np.asarray(pitch_m, dtype=np.float64), (2,))
        r, c = np.divmod(np.arange(rows * cols), max(cols, 1))
        u = (c - (cols - 1) / 2) * pitch[0]
        v = (r - (rows - 1) / 2) * pitch[1]
        return cls(rows, cols, np.column_stack([u, v]), np.asarray(taxel_size_m, dtype=np.float64))

    @property
    def taxels(self) -> int:
        """Number of taxels J."""
        return self.rows * self.cols

    def names(self, taxels: Iterable[int]) -> str:
        """Return row and column of taxels as text; only the first few of many."""
        return first_of(["({}, {})".format(*divmod(j, self.cols)) for j in taxels], MOST_NAMED)

    @property
    def bounds_m(self) -> FloatArray:
        """(2, 2): lowest and highest (u, v) [m] of all taxels."""
        half = self.sizes_m / 2
        return np.stack([(self.centres_m - half).min(axis=0), (self.centres_m + half).max(axis=0)])

    @property
    def apart_m(self) -> FloatArray:
        """(J, J): distances between the centres [m]; infinite on the diagonal."""
        apart = np.linalg.norm(self.centres_m[:, None] - self.centres_m, axis=-1)
        np.fill_diagonal(apart, np.inf)
        return apart

    def taxel_at(self, uv_m: ArrayLike) -> IntArray:
        """Return the flat index (N,) of the taxel that each point lies in; -1 in the gaps and the margin."""
        uv = np.asarray(uv_m, dtype=np.float64)
        by_v = np.argsort(uv[:, 1], kind="stable")
        low, high = self.centres_m - self.sizes_m / 2, self.centres_m + self.sizes_m / 2
        first = np.searchsorted(uv[by_v, 1], low[:, 1], side="left")
        last = np.searchsorted(uv[by_v, 1], high[:, 1], side="right")
        taxel = np.full(len(uv), -1, dtype=np.int64)
        for j in range(self.taxels):
            band = by_v[first[j] : last[j]]
            u = uv[band, 0]
            taxel[band[(u >= low[j, 0]) & (u <= high[j, 0])]] = j
        return taxel

    def _check_apart(self) -> None:
        """Raise ``ValueError`` if two taxels overlap: the shared stress would count twice."""
        low, high = self.centres_m - self.sizes_m / 2, self.centres_m + self.sizes_m / 2
        tolerance = 1e-9 * self.sizes_m.min()
        for j in range(self.taxels - 1):
            shared = np.minimum(high[j], high[j + 1 :]) - np.maximum(low[j], low[j + 1 :])
            clash = np.flatnonzero(np.all(shared > tolerance, axis=1))
            if clash.size:
                raise ValueError(
                    f"layout: expected taxels that do not overlap; got taxels {j} and {j + 1 + clash[0]} "
                    f"sharing {shared[clash[0], 0]:.3g} m x {shared[clash[0], 1]:.3g} m. "
                    "Is the pitch less than the taxel size?"
                )
