"""Responses of a skin to presses, loads of single points, and presses that the model has no answer for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.errors import InputError, Problem
from skincal.model.arrays import BoolArray, FloatArray, IntArray, check_shape
from skincal.model.contact import Contacts
from skincal.model.indenters.indenter import Indenter
from skincal.model.press.status import Status

_INVALID = {
    Status.FINER_THAN_POINTS: (
        "an indenter that is not finer than the tactile points, so that it does not fall between them",
        "Build the patch with a smaller resolution_m, or check the radius.",
    ),
    Status.THROUGH_FINGER: (
        "a penetration that indenter and finger allow",
        "Check force, elasticity and their units.",
    ),
}

_FIRST_INVALID = int(min(_INVALID))
"""A plain number: numpy compares with members of an enumeration slowly."""


class InvalidPressError(InputError, ValueError):
    """A press that the model has no answer for."""


@dataclass(frozen=True, eq=False)
class SkinResponse:
    """Response of the skin to a batch of K contacts.

    Attributes:
        loads_n: (K, J) loads that the taxels feel [N], before the scale.
        penetration_m: (K,) eps_max [m], from the first point touched.
        force_n: (K,) normal force that all points together carry [N]: F_n again, or 0.
        centroid_m: (K, 3) centre of that force [m]; NaN where there is none.
        points: (K,) number of points touched.
        status: (K,) a :class:`Status` for each press.
    """

    loads_n: FloatArray
    penetration_m: FloatArray
    force_n: FloatArray
    centroid_m: FloatArray
    points: IntArray
    status: IntArray


def refuse(indenter: Indenter, contacts: Contacts, info: FloatArray, *statuses: Status) -> None:
    """Raise an error if presses have a status that is refused.

    Args:
        indenter: what presses.
        contacts: K contacts.
        info: (K, 7) of :func:`skincal.model.press.call.press`.
        statuses: the refused ones.

    Raises:
        InvalidPressError: one of the presses has such a status.
    """
    found = info[:, 6]
    if not len(found) or found.max() < _FIRST_INVALID:
        return
    for status in statuses:
        bad = np.flatnonzero(found == status)
        if len(bad):
            k = bad[0]
            expected, fix = _INVALID[status]
            got = f"{contacts.force_n[k]:.6g} N by {indenter}, {info[k, 0]:.3g} m deep"
            raise InvalidPressError([Problem(f"contact {k} of {len(contacts)}", expected, got, fix)])


@dataclass(frozen=True, eq=False)
class Pressures:
    """Loads on the tactile points that K contacts touch, one contact after the other.

    Attributes:
        starts: (K + 1,) contact k has the entries from ``starts[k]`` to ``starts[k + 1]``.
        points: (P,) index of the tactile point of each entry.
        load_n: (P,) what it adds to its taxel [N]: E eps_i a_i max(n_c . n_t,i, 0) max(-n_s,i . n_c, 0).
        known: (K,) False where the force or the place is NaN or infinite.
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
        from scipy.sparse import csr_array  # takes half of the time that the package takes to load

        check_shape("weights", weights, (self.patch_points, None))
        shape = (len(self), self.patch_points)
        matrix = csr_array((self.load_n, self.points, self.starts), shape=shape)
        loads = np.asarray(matrix.dot(weights), dtype=np.float64)
        loads[~self.known] = np.nan
        return loads
