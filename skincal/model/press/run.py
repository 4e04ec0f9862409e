"""From contacts to the compiled routine and back. Imports numba when the first press is computed."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from skincal.model.arrays import FloatArray, IntArray
from skincal.model.contact import Contacts
from skincal.model.indenters.base import ClosedForm
from skincal.model.law import StressLaw

if TYPE_CHECKING:
    from skincal.model.patch import Patch

_NO_ENTRIES = np.zeros(0, dtype=np.int64), np.zeros(0)
INFO = 7
"""Numbers that the routine tells of a press: penetration, force, centroid (3), points touched, status."""

on_compile: Callable[[], None] | None = None
"""Called once before the routine is compiled, which takes seconds; not where it is found in the cache."""

_routine: Any = None


def routine() -> Any:
    """The compiled routine, made or fetched from the cache at first use."""
    global _routine
    if _routine is None:
        from skincal.model.press import compiled

        _routine = compiled.load(on_compile)
    return _routine


def press(
    patch: Patch,
    elasticity_pa_per_m: float,
    indenter: ClosedForm,
    contacts: Contacts,
    rows: IntArray,
    law: StressLaw | None,
    entry: IntArray | None = None,
    entries: IntArray = _NO_ENTRIES[0],
    entry_loads: FloatArray = _NO_ENTRIES[1],
) -> tuple[FloatArray, FloatArray]:
    """Loads (P, J) [N] and what else there is to tell (P, 7) of some contacts, all known and pressing.

    Args:
        patch: the tactile points.
        elasticity_pa_per_m: E [Pa/m].
        indenter: what presses.
        contacts: K contacts.
        rows: (P,) which of them.
        law: how stress grows with penetration; None: in proportion.
        entry: see :func:`skincal.model.press.routine.press`.
        entries: the same.
        entry_loads: the same.
    """
    loads, info = np.zeros((len(rows), patch.layout.taxels)), np.zeros((len(rows), INFO))
    places, starts = _places(contacts, rows)
    points = patch.tiled
    routine().press(
        points.points,
        points.taxel,
        points.border,
        points.tiles,
        indenter.kind,
        indenter.radius_m,
        min(indenter.depth_m, patch.depth_m),
        places,
        contacts.rotations is not None,
        starts,
        contacts.force_n[rows],
        elasticity_pa_per_m,
        1.0 if law is None else law.exponent,
        1.0 if law is None else law.reference_m,
        loads,
        info,
        np.zeros(len(rows), dtype=np.int64) if entry is None else entry,
        entries,
        entry_loads,
    )
    return loads, info


def _places(contacts: Contacts, rows: IntArray) -> tuple[FloatArray, IntArray]:
    """Places (P, 15) as the routine takes them, one for equal ones that follow each other, and where each starts."""
    every = np.zeros((len(rows), 15))
    every[:, :3] = contacts.normals[rows]
    every[:, 3:6] = contacts.indenter_origins_m[rows]
    if contacts.rotations is not None:
        every[:, 6:] = contacts.rotations[rows].reshape(-1, 9)
    if len(rows) < 2:
        return every, np.arange(len(rows) + 1)
    begins = np.ones(len(rows), dtype=np.bool_)
    begins[1:] = (every[1:] != every[:-1]).any(axis=1)
    return every[begins], np.append(np.flatnonzero(begins), len(rows))
