"""What a press does to a patch: loads, penetration, force (paper, section II-A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.errors import InputError, Problem
from skincal.model.arrays import FloatArray, IntArray
from skincal.model.contact import Contacts
from skincal.model.indenters.indenter import Indenter
from skincal.model.law import StressLaw
from skincal.model.patch import Patch
from skincal.model.press.call import press
from skincal.model.press.status import Status

_INVALID = {
    int(Status.FINER_THAN_POINTS): (
        "an indenter that is not finer than the tactile points, so that it does not fall between them",
        "Build the patch with a smaller resolution_m, or check the radius.",
    ),
    int(Status.THROUGH_FINGER): (
        "a penetration that indenter and finger allow",
        "Check force, elasticity and their units.",
    ),
}

_FIRST_INVALID = min(_INVALID)


class InvalidPressError(InputError, ValueError):
    """A press that the model has no answer for."""


@dataclass(frozen=True, eq=False)
class SkinResponse:
    """What a batch of K contacts does to the skin.

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


def respond(
    patch: Patch,
    elasticity_pa_per_m: float,
    indenter: Indenter,
    contacts: Contacts,
    law: StressLaw | None = None,
) -> SkinResponse:
    """Loads, penetration and force of every contact on a patch; what each status means is told there.

    Args:
        patch: the tactile points.
        elasticity_pa_per_m: E [Pa/m].
        indenter: what presses.
        contacts: K contacts.
        law: how stress grows with penetration; None: in proportion.
    """
    found, told = press(patch, elasticity_pa_per_m, indenter, contacts, law)
    points, status = told[:, 5:7].astype(np.int64).T
    return SkinResponse(found, told[:, 0], told[:, 1], told[:, 2:5], points, status)


def loads(
    patch: Patch,
    elasticity_pa_per_m: float,
    indenter: Indenter,
    contacts: Contacts,
    law: StressLaw | None = None,
    *,
    refuse: tuple[Status, ...] = (Status.FINER_THAN_POINTS,),
) -> FloatArray:
    """Loads (K, J) [N] as those of :func:`respond`, without the rest of what it says.

    Args:
        patch: the tactile points.
        elasticity_pa_per_m: E [Pa/m].
        indenter: what presses.
        contacts: K contacts.
        law: how stress grows with penetration; None: in proportion.
        refuse: which statuses are errors.

    Raises:
        ValueError: a press with a status that is refused.
    """
    found, told = press(patch, elasticity_pa_per_m, indenter, contacts, law)
    status = told[:, 6]
    if len(status) and status.max() >= _FIRST_INVALID:
        _refuse(indenter, contacts, told, refuse)
    return found


def _refuse(indenter: Indenter, contacts: Contacts, told: FloatArray, refuse: tuple[Status, ...]) -> None:
    for refused in refuse:
        bad = np.flatnonzero(told[:, 6] == refused)
        if len(bad):
            k = bad[0]
            expected, fix = _INVALID[refused]
            got = f"{contacts.force_n[k]:.6g} N by {indenter}, {told[k, 0]:.3g} m deep"
            raise InvalidPressError([Problem(f"contact {k} of {len(contacts)}", expected, got, fix)])
