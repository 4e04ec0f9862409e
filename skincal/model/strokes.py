"""One press with many forces: cast once, settled for every force (paper, section II-A).

While a press grows and fades the indenter stays where it is and only its force changes, so the distances of the points
are the same in all its samples. The points that the largest force reaches are all that any other of its forces can
reach.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import FloatArray, IntArray, as_floats
from skincal.model.contact import Contacts
from skincal.model.tiles import Tiles
from skincal.model.touch import Touch

_WORTH = 2
"""Samples a press must have, on average, before they are taken together."""
_SAME = 1e-13
"""Places [m] and directions that differ by less are the same but for the rounding of what they were worked out from."""


@dataclass(frozen=True, eq=False)
class Reached:
    """What the largest force of a press reaches, nearest point first.

    Attributes:
        gap_m: (N,) distances beyond the smallest [m], ascending, the first of them 0.
        weight_m2: (N,) a_i max(n_t,i . n_c, 0) [m²].
        facing: (N,) max(-n_s,i . n_c, 0).
        taxel: (N,) flat taxel index, -1 for none.
        point: (N,) index of the point in the patch.
    """

    gap_m: FloatArray
    weight_m2: FloatArray
    facing: FloatArray
    taxel: IntArray
    point: IntArray

    def depths(self, load_m3: FloatArray) -> FloatArray:
        """Penetrations (m,) [m] at which loads F / E (m,) > 0 are carried, exactly: between two gaps it is a line."""
        area, moment = np.cumsum(self.weight_m2), np.cumsum(self.weight_m2 * self.gap_m)
        carried = self.gap_m * area - moment
        last = np.maximum(np.searchsorted(carried, load_m3, side="right") - 1, 0)
        return as_floats((load_m3 + moment[last]) / area[last])

    def taxel_loads(self, depth_m: FloatArray, taxels: int) -> FloatArray:
        """Loads over E (m, J) [m³] that the taxels feel at penetrations (m,)."""
        # Summed up point after point, so that a sample's load does not depend on which other samples there are.
        area = np.zeros((len(self.gap_m), taxels + 1))
        area[np.arange(len(area)), self.taxel] = self.weight_m2 * self.facing
        moment = np.cumsum(area * self.gap_m[:, None], axis=0)
        area = np.cumsum(area, axis=0)
        last = np.searchsorted(self.gap_m, depth_m, side="right") - 1
        loads: FloatArray = np.maximum(depth_m[:, None] * area[last] - moment[last], 0.0)
        return loads[:, :taxels]

    def point_loads(self, depth_m: FloatArray) -> FloatArray:
        """Loads over E (m, N) [m³] that each of the points adds to its taxel at penetrations (m,)."""
        return as_floats(np.maximum(depth_m[:, None] - self.gap_m, 0.0) * (self.weight_m2 * self.facing))


def strokes(contacts: Contacts, pressed: IntArray) -> list[IntArray] | None:
    """Rows that follow each other and differ in their force alone; None where taking them together gains nothing.

    Args:
        contacts: K contacts.
        pressed: (P,) rows of them that are known and have a force, ascending.
    """
    if len(pressed) < _WORTH:
        return None
    same = np.ones(len(pressed) - 1, dtype=np.bool_)
    for part in (contacts.points_m, contacts.normals, contacts.rotations, contacts.origins_m):
        if part is not None:
            rows = part[pressed].reshape(len(pressed), -1)
            same &= (np.abs(rows[1:] - rows[:-1]) <= _SAME).all(axis=1)
    cuts = np.flatnonzero(~same) + 1
    if _WORTH * (len(cuts) + 1) > len(pressed):
        return None
    return np.split(pressed, cuts)


def deepest(contacts: Contacts, groups: list[IntArray]) -> dict[int, IntArray]:
    """Each group by its row of the largest force."""
    return {int(rows[np.argmax(contacts.force_n[rows])]): rows for rows in groups}


def reached(tiles: Tiles, found: Touch, k: int) -> Reached:
    """What carries in one of the contacts of a touch."""
    settled = found.settled
    gap, weight = settled.gap_m[k], settled.weight_m2[k]
    inside = np.flatnonzero((weight > 0) & (gap <= settled.depth_m[k]))
    inside = inside[np.argsort(gap[inside], kind="stable")]
    index: IntArray = tiles.index[found.tile[k]].reshape(-1)[inside]
    return Reached(gap[inside], weight[inside], found.facing[k, inside], found.taxel[k, inside], index)
