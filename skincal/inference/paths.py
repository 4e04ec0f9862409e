"""Paths of presses whose contact slides or rolls: nodes with a table each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.inference.press_table import PressTable
from skincal.model.arrays import FloatArray, IntArray

LEAST_M = 1e-5
"""Motion of a contact within a press that counts [m]."""
_EXPANDED_M = 1.2e-4
"""Distance from its node up to which the second-order expansion of a table and its slopes hold [m]."""


@dataclass(frozen=True, eq=False)
class Paths:
    """Straight paths of P presses, as R nodes: one at the place of each press, more where it slides.

    Attributes:
        press: (R,) of each node.
        offset_m: (R, 2) from the place of its press across and along [m].
        before: (K,) node before each sample on its way from the place, or at it; -1 without a press.
        after: (K,) node after it.
        part: (K,) of the way between them.
    """

    press: IntArray
    offset_m: FloatArray
    before: IntArray
    after: IntArray
    part: FloatArray

    @staticmethod
    def of(
        offset_m: FloatArray,
        row: IntArray,
        presses: int,
        spacing_m: float = 2 * _EXPANDED_M,
        least_m: float = _EXPANDED_M,
    ) -> Paths:
        """Lay nodes along the paths of samples.

        Args:
            offset_m: (K, 2) of each sample from the place of its press across and along [m].
            row: (K,) of its press; -1 for none.
            presses: how many there are.
            spacing_m: largest distance of nodes [m].
            least_m: motion from which a press has more than one [m].
        """
        own = np.maximum(row, 0)
        off = np.where((row >= 0)[:, None], offset_m, 0.0)
        spread = np.zeros((presses, 2, 2))
        np.add.at(spread, own, off[:, :, None] * off[:, None])
        way = np.linalg.eigh(spread)[1][:, :, 1]
        along = (way[own] * off).sum(axis=1)
        is_ahead = (along > 0).astype(np.int64)
        reach = np.zeros((2, presses))
        np.maximum.at(reach, (is_ahead, own), np.abs(along))
        many = np.where(reach > least_m, np.ceil(reach / spacing_m), 0.0).astype(np.int64)
        step = reach / np.maximum(many, 1)
        # The nodes of a press: its place, those behind it, those ahead.
        count = 1 + many.sum(axis=0)
        begin = np.cumsum(count) - count
        press = np.repeat(np.arange(presses), count)
        number = np.arange(len(press)) - begin[press]
        beyond = np.maximum(number - many[0, press], 0)
        signed = np.where(beyond > 0, beyond * step[1, press], -number * step[0, press])
        last = many[is_ahead, own]
        steps = np.where(last > 0, np.abs(along) / np.maximum(step[is_ahead, own], 1e-12), 0.0)
        first = np.minimum(steps.astype(np.int64), np.maximum(last - 1, 0))

        def node(k: IntArray) -> IntArray:
            return np.where(row >= 0, begin[own] + k + is_ahead * many[0, own] * (k > 0), -1)

        return Paths(
            press, signed[:, None] * way[press], node(first), node(np.minimum(first + 1, last)), steps - first
        )

    @property
    def nearest(self) -> IntArray:
        """Return the node (K,) nearest to each sample."""
        return np.where(self.part < 0.5, self.before, self.after)

    def nodes_at(self, places_m: FloatArray) -> FloatArray:
        """Return the places (R, 2) of the nodes for places (P, 2) of the presses [m]."""
        return places_m[self.press] + self.offset_m

    def between_nodes(self, table: PressTable, load_m3: FloatArray) -> FloatArray:
        """Look up loads over E (K, J) of samples at F / E (K,), linearly between nodes."""
        first = table.at(self.before, load_m3)
        if np.array_equal(self.before, self.after):
            return first
        return first + self.part[:, None] * (table.at(self.after, load_m3) - first)
