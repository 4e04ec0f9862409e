"""What a press does to a patch: loads, penetration, force (paper, section II-A)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import FloatArray, IntArray, as_floats
from skincal.model.contact import Contacts
from skincal.model.indenters.base import ClosedForm, Indenter
from skincal.model.law import StressLaw
from skincal.model.patch import Patch
from skincal.model.press.run import press as press_closed
from skincal.model.press.status import Status
from skincal.model.strokes import Reached, deepest, reached, strokes
from skincal.model.touch import Pressing, Touch, touch

_MOST_AT_ONCE = 64
"""Contacts worked on at once, at most."""
_ROOM = 240_000
"""Fewer at once on a patch of many points, so that their arrays stay in the processor's cache."""


# Plain numbers: an enumeration's members are slow to turn into arrays.
_OK, _NO_FORCE, _NOT_TOUCHED, _AT_BORDER, _UNKNOWN = (int(status) for status in tuple(Status)[:5])


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

    @classmethod
    def at_rest(cls, status: IntArray, taxels: int) -> SkinResponse:
        """No load anywhere; NaN where the status is unknown."""
        count = len(status)
        fill = np.where(status == _UNKNOWN, np.nan, 0.0)
        loads, centroid = np.repeat(fill[:, None], taxels, axis=1), np.full((count, 3), np.nan)
        return cls(loads, fill.copy(), fill, centroid, np.zeros(count, dtype=np.int64), status)


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
    known, presses = contacts.known, contacts.force_n > 0
    status = np.where(known, np.where(presses, _NOT_TOUCHED, _NO_FORCE), _UNKNOWN)
    response = SkinResponse.at_rest(status, patch.layout.taxels)
    pressed = np.flatnonzero(known & presses)
    if isinstance(indenter, ClosedForm):
        some, info = press_closed(patch, elasticity_pa_per_m, indenter, contacts, pressed, law)
        response.loads_n[pressed], response.penetration_m[pressed] = some, info[:, 0]
        response.force_n[pressed], response.points[pressed] = info[:, 1], info[:, 5]
        response.centroid_m[pressed] = np.where(info[:, 1:2] > 0, info[:, 2:5], np.nan)
        response.status[pressed] = info[:, 6]
        return response
    for rows, found in touches(patch, elasticity_pa_per_m, indenter, contacts, pressed, law):
        _enter(response, rows, patch.layout.taxels, elasticity_pa_per_m, found, law)
    return response


def loads(
    patch: Patch,
    elasticity_pa_per_m: float,
    indenter: Indenter,
    contacts: Contacts,
    law: StressLaw | None = None,
) -> FloatArray:
    """Loads (K, J) [N] as those of :func:`respond`, without the rest of what it says.

    Args:
        patch: the tactile points.
        elasticity_pa_per_m: E [Pa/m].
        indenter: what presses.
        contacts: K contacts.
        law: how stress grows with penetration; None: in proportion.
    """
    known, count = contacts.known, patch.layout.taxels
    found_n = np.zeros((len(contacts), count))
    found_n[~known] = np.nan
    pressed = np.flatnonzero(known & (contacts.force_n > 0))
    if isinstance(indenter, ClosedForm):
        found_n[pressed] = press_closed(patch, elasticity_pa_per_m, indenter, contacts, pressed, law)[0]
        return found_n
    groups = strokes(contacts, pressed)
    if groups is not None:
        for rows, here, press, depth in reaches(patch, elasticity_pa_per_m, indenter, contacts, groups, law):
            found_n[rows] = elasticity_pa_per_m * here.taxel_loads(press, depth, law, count)
        return found_n
    for rows, found in touches(patch, elasticity_pa_per_m, indenter, contacts, pressed, law):
        found_n[rows] = elasticity_pa_per_m * _on_taxels(found, carried_m3(found, law), count)
    return found_n


def reaches(
    patch: Patch,
    elasticity_pa_per_m: float,
    indenter: Indenter,
    contacts: Contacts,
    groups: list[IntArray],
    law: StressLaw | None,
) -> Iterator[tuple[IntArray, Reached, IntArray, FloatArray]]:
    """What presses with many forces reach, some presses at a time.

    Args:
        patch: the tactile points.
        elasticity_pa_per_m: E [Pa/m].
        indenter: what presses.
        contacts: K contacts.
        groups: of :func:`skincal.model.strokes.strokes`.
        law: how stress grows with penetration; None: in proportion.

    Yields:
        Rows (S,) of samples, what the largest forces of their presses reach, which of these presses each sample is of
        (S,), and penetrations (S,) [m]. A press that touches nothing is left out.
    """
    load_m3 = contacts.force_n / elasticity_pa_per_m
    by_row = deepest(contacts, groups)
    deep = np.array(list(by_row), dtype=np.int64)
    for some, found in touches(patch, elasticity_pa_per_m, indenter, contacts, deep, law):
        own = [by_row[row] for row in some.tolist()]
        many = np.array([len(rows) for rows in own])
        for those, here in reached(patch.tiles, found, many, patch.layout.taxels):
            rows: IntArray = np.concatenate([own[int(k)] for k in those])
            press = np.repeat(np.arange(len(those)), many[those])
            yield rows, here, press, here.depths(press, load_m3[rows], law)


def touches(
    patch: Patch,
    elasticity_pa_per_m: float,
    indenter: Indenter,
    contacts: Contacts,
    pressed: IntArray,
    law: StressLaw | None,
) -> Iterator[tuple[IntArray, Touch]]:
    """What some of the contacts touch, some rows at a time.

    Args:
        patch: the tactile points.
        elasticity_pa_per_m: E [Pa/m].
        indenter: what presses.
        contacts: K contacts.
        pressed: rows of them that are known and have a force.
        law: how stress grows with penetration; None: in proportion.

    Yields:
        Rows of the contacts, and what they touch.
    """
    if not (len(patch) and len(pressed)):
        return
    if len(pressed) > 1:
        # Alike forces together: the presses of a chunk share the number of tiles that they look at.
        pressed = pressed[np.argsort(contacts.force_n[pressed], kind="stable")]
    pressing = Pressing.of(contacts, pressed, indenter, elasticity_pa_per_m)
    chunk = int(min(max(_ROOM // len(patch), 1), _MOST_AT_ONCE))
    for k in range(0, len(pressed), chunk):
        rows = slice(k, k + chunk)
        part = pressing[rows] if chunk < len(pressed) else pressing
        yield pressed[rows], touch(patch.tiles, indenter, part, law)


def carried_m3(found: Touch, law: StressLaw | None) -> FloatArray:
    """What every point carries along the contact normal over E (K, M) [m³]."""
    gap, weight, depth = found.settled.gap_m, found.settled.weight_m2, found.settled.depth_m
    carried = np.maximum(depth[:, None] - gap, 0.0)
    if law is not None:
        carried = law.effective_m(carried)
    carried *= weight
    return carried


def _enter(
    response: SkinResponse,
    rows: IntArray,
    taxels: int,
    elasticity: float,
    found: Touch,
    law: StressLaw | None,
) -> None:
    """Sum up what was found for some rows; those that touch nothing stay as they are."""
    carried = carried_m3(found, law)
    touched = carried > 0
    sums = elasticity * (carried[:, None] @ found.points[..., :5])[:, 0]
    hit = sums[:, 3] > 0
    response.loads_n[rows] = elasticity * _on_taxels(found, carried, taxels)
    response.force_n[rows] = sums[:, 3]
    response.points[rows] = touched.sum(axis=1)
    response.penetration_m[rows] = found.settled.depth_m
    rows, sums = rows[hit], sums[hit]
    response.centroid_m[rows] = sums[:, :3] / sums[:, 3:4]
    response.status[rows] = np.where(sums[:, 4] > 0, _AT_BORDER, _OK)


def _on_taxels(found: Touch, carried: FloatArray, taxels: int) -> FloatArray:
    """What taxels feel over E (K, J) [m³], of what every point carries (K, M), which is used up."""
    bins = taxels + 1
    slot = found.taxel + (1 + bins * np.arange(len(carried)))[:, None]
    carried *= found.facing
    sums = np.bincount(slot.ravel(), carried.ravel(), len(carried) * bins)
    return as_floats(sums).reshape(-1, bins)[:, 1:]
