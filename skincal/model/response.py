"""Responses of a skin to presses, and presses that the model has no answer for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.errors import InputError, Problem
from skincal.model.arrays import FloatArray, IntArray
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
