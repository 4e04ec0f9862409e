"""Concatenation of two sessions of one rig to one dataset."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from skincal.covariates import TIMES
from skincal.dataset.dataset import Dataset
from skincal.dataset.spec import DatasetMeta
from skincal.dataset.tables import Frames, Presses
from skincal.errors import InputError, Problem, input_error

GAP_S = 10.0
"""Gap between the sessions if the clock of the second one has restarted [s]."""

Table = TypeVar("Table", Presses, Frames)


def join_sessions(first: Dataset, second: Dataset) -> Dataset:
    """Concatenate a session and a later one of the same rig, with continued press numbers and one clock.

    A column that only one session has is empty in the rows of the other.

    Raises:
        InputError: the sessions have different sensors or surfaces, or only one of them has frames.
    """
    place = "dataset" if second.folder is None else str(second.folder)
    check_same_rig(first.meta, second.meta, place)
    if (first.frames is None) != (second.frames is None):
        raise input_error(f"{place}: frames", "frames in both sessions or in none", "frames in one")
    number = int(first.presses.press.max(initial=-1)) + 1
    later, taxels = _later_s(first, second), first.meta.sensor.taxel_columns()
    presses = _concatenated(first.presses, second.presses, number, later, taxels)
    frames = None
    if first.frames is not None and second.frames is not None:
        frames = _concatenated(first.frames, second.frames, number, later, taxels)
    return replace(first, presses=presses, frames=frames, folder=None, sha256=None)


def check_same_rig(first: DatasetMeta, second: DatasetMeta, place: str) -> None:
    """Check that two sessions have the same sensor and surface; ``place`` is the source of the second, for errors.

    Raises:
        InputError: they differ.
    """
    pairs = ((first.sensor, second.sensor, "sensor"), (first.surface, second.surface, "surface"))
    fix = "Press the same sensor."
    if problems := [
        Problem(f"{place}: [{name}]", f"that of the first session, {mine}", str(other), fix)
        for mine, other, name in pairs
        if mine != other
    ]:
        raise InputError(problems)


def _later_s(first: Dataset, second: Dataset) -> float:
    """Return the offset of the second session's clock that places it after the first [s]."""
    ends: list[tuple[float, float]] = []
    if first.frames is not None and second.frames is not None and len(first.frames) and len(second.frames):
        ends.append((float(first.frames.time_s[-1]), float(second.frames.time_s[0])))
    old, new = first.presses.column(TIMES[-1]), second.presses.column(TIMES[0])
    if old is not None and new is not None and np.isfinite(old).any() and np.isfinite(new).any():
        ends.append((float(np.nanmax(old)), float(np.nanmin(new))))
    apart = min((begin - end for end, begin in ends), default=GAP_S)
    return 0.0 if apart > 0 else GAP_S - apart


def _concatenated(first: Table, second: Table, press: int, later_s: float, taxels: tuple[str, ...]) -> Table:
    """Concatenate two tables; a column that one of them lacks is empty there.

    ``press`` is the offset of the second table's press numbers, ``later_s`` that of its times [s].
    """
    import pandas as pd

    a, b = first.to_pandas(taxels), second.to_pandas(taxels)
    b["press"] = b["press"].mask(b["press"] >= 0, b["press"] + press)
    for name in (*TIMES, "time_s"):
        if name in b:
            b[name] += later_s
    for one, other in ((a, b), (b, a)):
        for name in set(other) - set(one):
            number = other[name].dtype.kind in "biuf"
            one[name] = np.nan if number else ""
            other[name] = other[name].astype(float) if number else other[name]
    return type(first).of_pandas(pd.concat([a, b[[*a]]], ignore_index=True), taxels)
