"""One press with many forces: cast once, settled for every force (paper, section II-A).

While a press grows and fades the indenter stays where it is and only its force changes, so the distances of the points
are the same in all its samples. The points that the largest force reaches are all that any other of its forces can
reach.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats
from skincal.model.contact import Contacts
from skincal.model.equilibrium import Settled
from skincal.model.law import StressLaw, settle_under
from skincal.model.tiles import Tiles
from skincal.model.touch import Touch

_WORTH = 2
"""Samples a press must have, on average, before they are taken together."""
_SAME = 1e-13
"""Places [m] and directions that differ by less are the same but for the rounding of what they were worked out from."""
_AT_ONCE = 200_000
"""Numbers in the largest array of presses that are worked out at once: it should stay in the processor's cache."""


@dataclass(frozen=True, eq=False)
class Reached:
    """What the largest forces of m presses reach, nearest point first.

    Attributes:
        gap_m: (m, N) distances beyond the smallest [m], ascending, the first of them 0; inf where a press reaches fewer
            points than others.
        weight_m2: (m, N) a_i max(n_t,i . n_c, 0) [m²]; zero where there is no point.
        facing: (m, N) max(-n_s,i . n_c, 0).
        taxel: (m, N) flat taxel index, -1 for none.
        point: (m, N) index of the point in the patch.
    """

    gap_m: FloatArray
    weight_m2: FloatArray
    facing: FloatArray
    taxel: IntArray
    point: IntArray

    def depths(self, press: IntArray, load_m3: FloatArray, law: StressLaw | None) -> FloatArray:
        """Penetrations (S,) [m] at which the presses (S,) carry loads F / E (S,) > 0.

        In proportion the depth is exact: between two gaps the load is a line.
        """
        area = np.cumsum(self.weight_m2, axis=1)
        moment = np.cumsum(self.weight_m2 * self._finite_gap_m, axis=1)
        carried = self.gap_m * area - moment
        last = np.maximum((carried[press] <= load_m3[:, None]).sum(axis=1) - 1, 0)
        depth = as_floats((load_m3 + moment[press, last]) / area[press, last])
        if law is None:
            return depth
        alone = Settled(np.zeros(len(press)), depth, self._finite_gap_m[press], self.weight_m2[press])
        return settle_under(law, alone, load_m3).depth_m

    def taxel_loads(
        self, press: IntArray, depth_m: FloatArray, law: StressLaw | None, taxels: int
    ) -> FloatArray:
        """Loads over E (S, J) [m³] that the taxels feel where presses (S,) are so deep (S,) [m]."""
        bins = taxels + 1
        slot = self.taxel[press]
        slot += (1 + bins * np.arange(len(press)))[:, None]
        # Summed up point after point, so that a sample's load does not depend on which other samples there are.
        sums = np.bincount(slot.ravel(), self.point_loads(press, depth_m, law).ravel(), len(press) * bins)
        return as_floats(sums).reshape(-1, bins)[:, 1:]

    def point_loads(self, press: IntArray, depth_m: FloatArray, law: StressLaw | None) -> FloatArray:
        """Loads over E (S, N) [m³] that each of the points adds to its taxel where presses (S,) are so deep (S,)."""
        local: FloatArray = np.maximum(depth_m[:, None] - self.gap_m[press], 0.0)
        if law is not None:
            local = law.effective_m(local)
        local *= (self.weight_m2 * self.facing)[press]
        return local

    @property
    def _finite_gap_m(self) -> FloatArray:
        return np.where(np.isfinite(self.gap_m), self.gap_m, 0.0)


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


def reached(tiles: Tiles, found: Touch, samples: IntArray, taxels: int) -> Iterator[tuple[IntArray, Reached]]:
    """What carries in the contacts of a touch, some of them at a time; those that touch nothing are left out.

    Args:
        tiles: the points of the patch.
        found: K contacts.
        samples: (K,) number of samples of the press of each.
        taxels: J.

    Yields:
        Rows (m,) of the touch, and what they reach.
    """
    settled = found.settled
    inside = (settled.weight_m2 > 0) & (settled.gap_m <= settled.depth_m[:, None])
    points = inside.sum(axis=1)
    room = samples * max(int(points.max(initial=1)), taxels + 1)
    batch = np.cumsum(room) // _AT_ONCE
    for number in np.unique(batch):
        rows = np.flatnonzero((batch == number) & (points > 0))
        if len(rows):
            yield rows, _reached(tiles, found, rows, inside[rows])


def _reached(tiles: Tiles, found: Touch, rows: IntArray, inside: BoolArray) -> Reached:
    far = np.where(inside, found.settled.gap_m[rows], np.inf)
    order = np.argsort(far, axis=1, kind="stable")[:, : int(inside.sum(axis=1).max())]
    taken = np.take_along_axis(inside, order, axis=1)
    index = tiles.index[found.tile[rows]].reshape(len(rows), -1)
    return Reached(
        np.take_along_axis(far, order, axis=1),
        np.where(taken, np.take_along_axis(found.settled.weight_m2[rows], order, axis=1), 0.0),
        np.take_along_axis(found.facing[rows], order, axis=1),
        np.take_along_axis(found.taxel[rows], order, axis=1),
        np.take_along_axis(index, order, axis=1),
    )
