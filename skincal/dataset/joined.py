"""Two sessions of one rig as one dataset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.dataset import Dataset
from skincal.dataset.spec import DatasetMeta
from skincal.dataset.tables import Frames, Presses
from skincal.errors import InputError, Problem

TIMES = ("t_start_s", "t_hold_s", "t_release_s", "t_end_s")
"""Columns of presses on the clock of the session."""
GAP_S = 10.0
"""The second session begins so long after the first, if its clock does not say that it was later [s]."""

Columns = Mapping[str, NDArray[Any]]


def joined(first: Dataset, second: Dataset) -> Dataset:
    """Return the presses of a session and of a later one, numbered on, on one clock.

    A column that only one of them has is empty in the rows of the other.

    Args:
        first: the earlier session; what it says of sensor, rig and source holds for both.
        second: the later one.

    Raises:
        InputError: they are of different sensors or surfaces, or only one of them has frames.
    """
    place = "dataset" if second.folder is None else str(second.folder)
    check_same_rig(first.meta, second.meta, place)
    if (first.frames is None) != (second.frames is None):
        raise InputError([Problem(f"{place}: frames", "frames in both sessions or in none", "frames in one")])
    number = int(first.presses.press.max(initial=-1)) + 1
    later = _later_s(first, second)
    a, b = first.presses, second.presses
    columns = dict(b.columns)
    for name in TIMES:
        if name in columns:
            columns[name] = columns[name] + later
    normals = None
    if a.normals is not None or b.normals is not None:
        normals = np.concatenate(
            [np.full((len(p), 3), np.nan) if p.normals is None else p.normals for p in (a, b)]
        )
    presses = Presses(
        np.concatenate([a.press, b.press + number]),
        np.concatenate([a.position_m, b.position_m]),
        np.concatenate([a.force_n, b.force_n]),
        np.concatenate([a.counts, b.counts]),
        normals,
        _columns(a.columns, columns, len(a), len(b)),
    )
    return replace(
        first,
        presses=presses,
        frames=_frames(first.frames, second.frames, number, later),
        folder=None,
        sha256=None,
    )


def check_same_rig(first: DatasetMeta, second: DatasetMeta, place: str) -> None:
    """Check that two sessions are of one sensor on one surface.

    Raises:
        InputError: they are not; ``place`` says where the second one comes from.
    """
    pairs = ((first.sensor, second.sensor, "sensor"), (first.surface, second.surface, "surface"))
    problems = [
        Problem(
            f"{place}: [{name}]", f"that of the first session, {mine}", str(other), "Press the same sensor."
        )
        for mine, other, name in pairs
        if mine != other
    ]
    if problems:
        raise InputError(problems)


def _later_s(first: Dataset, second: Dataset) -> float:
    """How much is added to the second session's clock [s]."""
    ends: list[tuple[float, float]] = []
    if first.frames is not None and second.frames is not None and len(first.frames) and len(second.frames):
        ends.append((float(first.frames.time_s[-1]), float(second.frames.time_s[0])))
    old, new = first.presses.column(TIMES[-1]), second.presses.column(TIMES[0])
    if old is not None and new is not None and np.isfinite(old).any() and np.isfinite(new).any():
        ends.append((float(np.nanmax(old)), float(np.nanmin(new))))
    apart = min((begin - end for end, begin in ends), default=GAP_S)
    return 0.0 if apart > 0 else GAP_S - apart


def _frames(a: Frames | None, b: Frames | None, number: int, later: float) -> Frames | None:
    if a is None or b is None:
        return None
    return Frames(
        np.concatenate([a.press, np.where(b.press >= 0, b.press + number, -1)]),
        np.concatenate([a.phase, b.phase]),
        np.concatenate([a.time_s, b.time_s + later]),
        np.concatenate([a.force_n, b.force_n]),
        np.concatenate([a.position_m, b.position_m]),
        np.concatenate([a.counts, b.counts]),
        _columns(a.columns, b.columns, len(a), len(b)),
    )


def _columns(a: Columns, b: Columns, first: int, second: int) -> dict[str, NDArray[Any]]:
    def filled(columns: Columns, name: str, count: int) -> NDArray[Any]:
        if name in columns:
            return columns[name]
        text = (a.get(name, b.get(name, np.zeros(0)))).dtype == object
        return np.full(count, "", dtype=object) if text else np.full(count, np.nan)

    return {
        name: np.concatenate([filled(a, name, first), filled(b, name, second)])
        for name in dict.fromkeys([*a, *b])
    }
