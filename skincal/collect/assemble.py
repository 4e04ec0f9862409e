"""From a session's journal to a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.collect.journal import Journal
from skincal.covariates import POSITION
from skincal.dataset import Dataset, DatasetMeta, Frames, Presses
from skincal.dataset.count_checks import DEAD_STRETCH, long_stretches

Arrays = dict[str, NDArray[Any]]

OWN_OF_PRESSES = ("press", *POSITION, "force_n", "counts")
OWN_OF_FRAMES = (*OWN_OF_PRESSES, "phase", "time_s")
OPTIONAL = ("temperature_c", "indenter_radius_m")
"""Columns that are left out if nothing was measured."""

LAST = ("missed_target", "slip_m", "status", "kind")
"""Further columns, after those of the format."""


def dataset_of(journal: Journal, meta: DatasetMeta, source: str, created: datetime) -> Dataset:
    """Return the dataset of all finished presses and the frames around them.

    Args:
        journal: journal of the session.
        meta: sensor, surface, indenter and mount of the hand's description.
        source: for ``dataset.toml``.
        created: start of the session.

    Returns:
        The dataset, with presses in the order of their numbers, and frames in the order of time.
    """
    presses = [arrays for _, arrays in sorted(journal.presses().items())]
    stretches = [_part(arrays, "frames.") for arrays in [*presses, *journal.rests()]]
    stretches = [stretch for stretch in stretches if len(stretch["time_s"])]
    stretches.sort(key=lambda stretch: float(stretch["time_s"][0]))
    meta = replace(meta, source=source, created=created, sensor=replace(meta.sensor, baseline="raw"))
    return Dataset(meta, _presses([_part(arrays, "press.") for arrays in presses]), _frames(stretches))


def _presses(rows: Sequence[Arrays]) -> Presses:
    table = {name: _column(rows, name) for name in _names(rows)}
    own = {name: table.pop(name) for name in OWN_OF_PRESSES}
    return Presses(
        own["press"].astype(np.int64),
        np.stack([own[name] for name in POSITION], axis=1),
        own["force_n"],
        own["counts"],
        columns=_ordered(_given(table)),
    )


def _frames(stretches: Sequence[Arrays]) -> Frames:
    table = {name: np.concatenate([s[name] for s in stretches]) for name in stretches[0]}
    kept = _answered(table["counts"])
    table = {name: column[kept] for name, column in table.items()}
    own = {name: table.pop(name) for name in OWN_OF_FRAMES}
    position = np.stack([own[name] for name in POSITION], axis=1)
    nothing = own["press"] < 0
    return Frames(
        own["press"].astype(np.int64),
        own["phase"].astype(np.int8),
        own["time_s"],
        own["force_n"],
        np.where(nothing[:, None], np.nan, position),
        own["counts"],
        columns=_given(table),
    )


def _answered(counts: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which frames (M,) are kept: a frame in which a taxel failed to respond for a moment is not an image."""
    kept = np.ones(len(counts), dtype=bool)
    while True:
        missing = np.isnan(counts[kept])
        # A taxel that is silent for long is dead, and its NaN stays.
        moment = missing & ~long_stretches(missing, DEAD_STRETCH) & ~missing.all(axis=0)
        if not moment.any():
            return kept
        kept[np.flatnonzero(kept)[moment.any(axis=1)]] = False


def _names(rows: Sequence[Arrays]) -> list[str]:
    """Return the names of all columns, in the order of their first occurrence."""
    return list(dict.fromkeys(name for row in rows for name in row))


def _column(rows: Sequence[Arrays], name: str) -> NDArray[Any]:
    """Return a column of the rows; NaN for rows that do not have it."""
    return np.array([row.get(name, np.nan) for row in rows])


def _given(table: Arrays) -> Arrays:
    """Return the columns with text as objects, without columns in which nothing was measured."""
    return {
        name: column.astype(object) if column.dtype.kind == "U" else column
        for name, column in table.items()
        if not (name in OPTIONAL and column.dtype.kind == "f" and np.isnan(column).all())
    }


def _ordered(table: Arrays) -> Arrays:
    last = {
        name: table[name] for name in table if name in LAST or name.startswith(("tau_rest_", "q_desired_"))
    }
    return {name: column for name, column in table.items() if name not in last} | last


def _part(arrays: Arrays, prefix: str) -> Arrays:
    return {name.removeprefix(prefix): column for name, column in arrays.items() if name.startswith(prefix)}
