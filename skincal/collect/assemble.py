"""From a session's journal to a dataset, and its check for a level at rest that shifted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from skincal.collect.journal import Arrays, Journal
from skincal.collect.record import OF_SKIN
from skincal.covariates import POSITION
from skincal.dataset import IDLE, Dataset, DatasetMeta, Frames, Presses
from skincal.dataset.rest import ACTIVE_COUNTS
from skincal.dataset.table_conversion import DEAD_STRETCH, long_stretches
from skincal.errors import Problem
from skincal.model.arrays import FloatArray

OWN_OF_PRESSES = ("press", *POSITION, "force_n", "counts")
OWN_OF_FRAMES = (*OWN_OF_PRESSES, "phase", "time_s")
OPTIONAL = (*OF_SKIN, "indenter_radius_m")
"""Columns that are left out if nothing was measured."""

LAST = ("missed_target", "slip_m", "status", "kind")
"""Further columns, after those of the format."""


def dataset_of(journal: Journal, meta: DatasetMeta, source: str, created: datetime) -> Dataset:
    """Return the dataset of all finished presses, by number, and of the frames around them, in the order of time."""
    presses = [arrays for _, arrays in sorted(journal.presses().items())]
    stretches = [_part(arrays, "frames.") for arrays in [*presses, *journal.rests()]]
    stretches = [stretch for stretch in stretches if len(stretch["time_s"])]
    stretches.sort(key=lambda stretch: float(stretch["time_s"][0]))
    meta = replace(meta, source=source, created=created, sensor=replace(meta.sensor, baseline="raw"))
    return Dataset(meta, _presses([_part(arrays, "press.") for arrays in presses]), _frames(stretches))


def _presses(rows: Sequence[Arrays]) -> Presses:
    names = dict.fromkeys(name for row in rows for name in row)
    table = {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}
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
        own["press"].astype(np.int64), own["phase"].astype(np.int8), own["time_s"], own["force_n"],
        np.where(nothing[:, None], np.nan, position), own["counts"], columns=_given(table),
    )  # fmt: skip


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


AROUND = 3
"""Number of pauses on each side whose median is compared: a slow recovery of the skin is over in the next but one."""

SIGMAS = 8.0
"""A shift exceeds this many standard errors of the levels, and the threshold of an active taxel: noise alone
does not reach it in a hundred presses on a hundred taxels."""

FIX = (
    "If the sensor or its driver tares automatically, allow that only without contact; taxels that are tared under "
    "load read too low from then on."
)


def rest_shifts(dataset: Dataset) -> tuple[Problem, ...]:
    """Return the presses after which taxels rest at another level than before, permanently."""
    numbers, levels, errors = _pauses(dataset)
    problems: list[Problem] = []
    for k in range(1, len(levels)):
        # NaN for a taxel that is silent in one of the pauses.
        before = np.median(levels[max(k - AROUND, 0) : k], axis=0)
        after = np.median(levels[k : k + AROUND], axis=0)
        step, shift = np.abs(levels[k] - levels[k - 1]), np.abs(after - before)
        least = np.maximum(ACTIVE_COUNTS, SIGMAS * np.hypot(errors[k], errors[k - 1]))
        shifted = np.flatnonzero((shift > least) & (step > 0.5 * shift))
        if len(shifted):
            worst = int(shifted[np.argmax(shift[shifted])])
            name = dataset.meta.sensor.taxel_columns()[worst]
            more = f" ({len(shifted)} taxels in all)" if len(shifted) > 1 else ""
            got = f"{name} at {before[worst]:.3g} counts before and {after[worst]:.3g} after{more}"
            expected = "the same level at rest before and after it"
            problems.append(Problem(f"press {numbers[k - 1]}", expected, got, FIX))
    return tuple(problems)


def _pauses(dataset: Dataset) -> tuple[list[int], FloatArray, FloatArray]:
    """Return the presses between pauses, and the level at rest of each pause with its standard error, (pauses, J)."""
    frames = dataset.frames
    assert frames is not None
    idle = frames.phase == IDLE
    starts = np.flatnonzero(np.diff(idle, prepend=~idle[:1]))
    numbers: list[int] = []
    levels: list[FloatArray] = []
    errors: list[FloatArray] = []
    pressed = -1
    for begin, end in zip(starts, [*starts[1:], len(idle)], strict=True):
        counts = frames.counts[begin:end]
        if not idle[begin]:
            pressed = int(frames.press[begin])
        elif end - begin > 1:
            if levels:
                numbers.append(pressed)
            levels.append(np.mean(counts, axis=0))
            # Whole counts: a constant level is known to a part of a step.
            errors.append(np.maximum(counts.std(axis=0, ddof=1), 0.3) / np.sqrt(end - begin))
    shape = (len(levels), frames.counts.shape[1])
    return numbers, np.reshape(levels, shape), np.reshape(errors, shape)
