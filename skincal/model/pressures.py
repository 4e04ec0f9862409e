"""Loads of contacts on single tactile points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from skincal.model.arrays import BoolArray, FloatArray, IntArray, check_shape


@dataclass(frozen=True, eq=False)
class Pressures:
    """Loads on the tactile points that K contacts touch, one contact after the other.

    Attributes:
        starts: (K + 1,) contact k has the entries from ``starts[k]`` to ``starts[k + 1]``.
        points: (P,) index of the tactile point of each entry.
        load_n: (P,) what it adds to its taxel [N]: E eps_i a_i max(n_c . n_t,i, 0) max(-n_s,i . n_c, 0).
        known: (K,) False where the force or the place is NaN or infinite.
        patch_points: number of points of the patch.
    """

    starts: IntArray
    points: IntArray
    load_n: FloatArray
    known: BoolArray
    patch_points: int

    def __len__(self) -> int:
        return len(self.known)

    def loads(self, weights: FloatArray) -> FloatArray:
        """Return loads on regions (K, J) [N], NaN where a contact is not known.

        Args:
            weights: (N, J) how much of a tactile point belongs to each region; 0 and 1 for taxels as they are.
        """
        check_shape("weights", weights, (self.patch_points, None))
        shape = (len(self), self.patch_points)
        matrix = csr_array((self.load_n, self.points, self.starts), shape=shape)
        loads = np.asarray(matrix.dot(weights), dtype=np.float64)
        loads[~self.known] = np.nan
        return loads
