"""Responses of a skin to presses and their outcomes, loads of single points, and invalid presses."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from skincal.errors import InputError, Problem
from skincal.model.arrays import BoolArray, FloatArray, IntArray, check_shape
from skincal.model.contact import Contacts
from skincal.model.indenters.indenter import Indenter


class Status(IntEnum):
    """Outcome of a press."""

    OK = 0
    """The patch carries the force, and the press stays inside it."""
    NO_FORCE = 1
    """The force is zero or negative: no load."""
    NOT_TOUCHED = 2
    """No point of the patch is touched: no load, although there is a force."""
    AT_BORDER = 3
    """The press reaches the patch's border: the points in contact carry the whole force."""
    UNKNOWN = 4
    """The force, position or normal is NaN or infinite: the load is NaN."""
    FINER_THAN_POINTS = 5
    """The indenter lies over the patch but falls between its points: the load is meaningless."""
    THROUGH_FINGER = 6
    """The penetration exceeds the depth of the indenter or the finger: the model no longer holds."""


_INVALID = {
    Status.FINER_THAN_POINTS: (
        "an indenter that is not finer than the tactile points and does not fall between them",
        "Build the patch with a smaller resolution_m, or check the radius.",
    ),
    Status.THROUGH_FINGER: (
        "a penetration within the depth of indenter and finger",
        "Check force, elasticity and their units.",
    ),
}

_FIRST_INVALID = int(min(_INVALID))
"""A plain integer: numpy is slow to compare with members of an enumeration."""


class InvalidPressError(InputError, ValueError):
    """A press that the model cannot simulate."""


@dataclass(frozen=True, eq=False)
class SkinResponse:
    """Response of the skin to a batch of K contacts.

    Attributes:
        loads_n: (K, J) loads on the taxels [N], before the scale.
        penetration_m: (K,) eps_max [m], measured from first touch.
        force_n: (K,) normal force carried by all points together [N]: F_n, or 0 without contact.
        centroid_m: (K, 3) centre of that force [m]; NaN without contact.
        points: (K,) number of points in contact.
        status: (K,) a :class:`Status` for each press.
    """

    loads_n: FloatArray
    penetration_m: FloatArray
    force_n: FloatArray
    centroid_m: FloatArray
    points: IntArray
    status: IntArray


def refuse(indenter: Indenter, contacts: Contacts, info: FloatArray, *statuses: Status) -> None:
    """Raise an error if a press has one of the given statuses.

    Args:
        indenter: the indenter.
        contacts: K contacts.
        info: (K, 7) from :func:`skincal.model.press.call.press`.
        statuses: statuses to refuse.

    Raises:
        InvalidPressError: a press has such a status.
    """
    status_of = info[:, 6]
    if not len(status_of) or status_of.max() < _FIRST_INVALID:
        return
    for status in statuses:
        bad = np.flatnonzero(status_of == status)
        if len(bad):
            k = bad[0]
            expected, fix = _INVALID[status]
            got = f"{contacts.force_n[k]:.6g} N by {indenter}, {info[k, 0]:.3g} m deep"
            raise InvalidPressError([Problem(f"contact {k} of {len(contacts)}", expected, got, fix)])


@dataclass(frozen=True, eq=False)
class Pressures:
    """Loads on the tactile points that K contacts touch, as the entries of a sparse matrix (K, N) in CSR form.

    Attributes:
        starts: (K + 1,) contact k has the entries from ``starts[k]`` to ``starts[k + 1]``.
        points: (P,) index of the tactile point of each entry.
        load_n: (P,) contribution to the load of its taxel [N]: E eps_i a_i max(n_c . n_t,i, 0) max(-n_s,i . n_c, 0).
        known: (K,) False where the force or position is NaN or infinite.
        patch_points: number N of points of the patch.
    """

    starts: IntArray
    points: IntArray
    load_n: FloatArray
    known: BoolArray
    patch_points: int

    def __len__(self) -> int:
        return len(self.known)

    def loads(self, weights: FloatArray) -> FloatArray:
        """Return loads on regions (K, J) [N]; NaN where a contact is not known.

        Args:
            weights: (N, J) fraction of each tactile point that belongs to each region; 0 or 1 for the taxels.
        """
        from scipy.sparse import csr_array  # takes a moment, and few need the loads of points

        check_shape("weights", weights, (self.patch_points, None))
        shape = (len(self), self.patch_points)
        matrix = csr_array((self.load_n, self.points, self.starts), shape=shape)
        loads = np.asarray(matrix.dot(weights), dtype=np.float64)
        loads[~self.known] = np.nan
        return loads
