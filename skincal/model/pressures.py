"""Where contacts press how hard, tactile point by tactile point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from skincal.model.arrays import BoolArray, FloatArray, IntArray, check_shape
from skincal.model.contact import Contacts
from skincal.model.indenters.indenter import Indenter
from skincal.model.law import StressLaw
from skincal.model.patch import Patch
from skincal.model.press.call import Entries, press
from skincal.model.press.status import Status


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
        """Loads on regions (K, J) [N], NaN where a contact is not known.

        Args:
            weights: (N, J) how much of a tactile point belongs to each region; 0 and 1 for taxels as they are.
        """
        check_shape("weights", weights, (self.patch_points, None))
        shape = (len(self), self.patch_points)
        matrix = csr_array((self.load_n, self.points, self.starts), shape=shape)
        loads = np.asarray(matrix.dot(weights), dtype=np.float64)
        loads[~self.known] = np.nan
        return loads


def pressures(
    patch: Patch,
    elasticity_pa_per_m: float,
    indenter: Indenter,
    contacts: Contacts,
    law: StressLaw | None = None,
) -> Pressures:
    """Loads on the tactile points, of every contact.

    Args:
        patch: the tactile points.
        elasticity_pa_per_m: E [Pa/m].
        indenter: what presses.
        contacts: K contacts.
        law: how stress grows with penetration; None: in proportion.
    """
    # Counted first, then told: how many points there will be is not known before.
    _, info = press(patch, elasticity_pa_per_m, indenter, contacts, law)
    told = Entries.of(info)
    press(patch, elasticity_pa_per_m, indenter, contacts, law, told)
    starts, known = np.append(told.begin, len(told.points)), info[:, 6] != Status.UNKNOWN
    return Pressures(starts, patch.tiled.index[told.points], told.load_n, known, len(patch))
