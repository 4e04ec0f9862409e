"""Where contacts press how hard, tactile point by tactile point."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from skincal.model.arrays import BoolArray, FloatArray, IntArray, check_shape
from skincal.model.contact import Contacts
from skincal.model.indenters.base import ClosedForm, Indenter
from skincal.model.law import StressLaw
from skincal.model.patch import Patch
from skincal.model.press.run import press as press_closed
from skincal.model.response import carried_m3, reaches, touches
from skincal.model.strokes import strokes


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
    known = contacts.known
    pressed = np.flatnonzero(known & (contacts.force_n > 0))
    if isinstance(indenter, ClosedForm):
        _, info = press_closed(patch, elasticity_pa_per_m, indenter, contacts, pressed, law)
        many = np.zeros(len(contacts), dtype=np.int64)
        many[pressed] = info[:, 5]
        begin = np.concatenate([[0], np.cumsum(many)])
        index, load_n = np.zeros(begin[-1], dtype=np.int64), np.zeros(begin[-1])
        press_closed(
            patch, elasticity_pa_per_m, indenter, contacts, pressed, law, begin[pressed], index, load_n
        )
        return Pressures(begin, patch.tiled.index[index], load_n, known, len(patch))
    rows: list[IntArray] = []
    points: list[IntArray] = []
    loads: list[FloatArray] = []
    for some, index, load in _terms(patch, elasticity_pa_per_m, indenter, contacts, pressed, law):
        touched = load > 0
        rows.append(some[np.nonzero(touched)[0]])
        points.append(index[touched])
        loads.append(load[touched])
    row = np.concatenate(rows) if rows else np.zeros(0, dtype=np.int64)
    order = np.argsort(row, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(contacts)))]).astype(np.int64)
    if not rows:
        return Pressures(starts, np.zeros(0, dtype=np.int64), np.zeros(0), known, len(patch))
    return Pressures(starts, np.concatenate(points)[order], np.concatenate(loads)[order], known, len(patch))


def _terms(
    patch: Patch,
    elasticity_pa_per_m: float,
    indenter: Indenter,
    contacts: Contacts,
    pressed: IntArray,
    law: StressLaw | None,
) -> Iterator[tuple[IntArray, IntArray, FloatArray]]:
    """Rows (k,) of some contacts, the points near them (k, M), and what each adds to its taxel (k, M) [N]."""
    groups = strokes(contacts, pressed)
    if groups is not None:
        for some, here, press, depth in reaches(patch, elasticity_pa_per_m, indenter, contacts, groups, law):
            yield some, here.point[press], elasticity_pa_per_m * here.point_loads(press, depth, law)
        return
    for some, found in touches(patch, elasticity_pa_per_m, indenter, contacts, pressed, law):
        load = elasticity_pa_per_m * carried_m3(found, law) * found.facing
        yield some, patch.tiles.index.take(found.tile, axis=0).reshape(len(some), -1), load
