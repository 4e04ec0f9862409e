"""Conversion of the tables of a file to :class:`Presses` and :class:`Frames`; every violation is reported.

Counts are numbers within the converter's range, and NaN only where a taxel is dead.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from itertools import pairwise

import numpy as np

from skincal.covariates import ANY, NORMAL, POSITION, TIMES
from skincal.dataset.columns import (
    CORRECT_OR_EMPTY,
    GIVE_OR_DROP,
    NO_FORCE,
    OPTIONAL,
    ColumnReader,
    is_number,
    repeated,
)
from skincal.dataset.findings import BadCells
from skincal.dataset.spec import DatasetMeta, SensorSpec
from skincal.dataset.table_file import RawTable
from skincal.dataset.tables import IDLE, PHASES, Frames, LazyColumns, Presses
from skincal.errors import first_of
from skincal.model.arrays import BoolArray, FloatArray

OF_PRESSES = ("press", *POSITION, "force_n")
OF_FRAMES = ("press", "phase", "time_s", "force_n", *POSITION)
"""Required columns of presses and of frames, beside the taxels."""


def presses_from(table: RawTable, meta: DatasetMeta) -> Presses:
    """Return the presses of a table; add problems to the table's findings."""
    reader, taxels = ColumnReader(table), meta.sensor.taxel_columns()
    _require(reader, OF_PRESSES, taxels, "press", "Was the table cut short, or filtered too strictly?")
    press = reader.whole("press", "a whole number, 0 or more", 0, "Number the presses 0, 1, 2, …")
    counts = reader.matrix(taxels)
    known, taken = OPTIONAL | dict.fromkeys(TIMES, ANY), {*OF_PRESSES, *NORMAL, *reader.taxel_columns(taxels)}
    presses = Presses(
        press=press,
        position_m=reader.checked_matrix(POSITION, ANY, may_be_nan=math.isinf(meta.position.sigma_m)),
        force_n=reader.checked("force_n", ANY, may_be_nan=False, if_empty=NO_FORCE),
        counts=counts,
        normals=_normals(reader),
        columns=dict(reader.optional(known, taken)),
    )
    if reader.has("press"):  # invalid numbers have been reported
        copies = repeated(press) & (press >= 0)
        fix = "Remove the copy; if they are two presses, give each its own number."
        reader.sheet.bad_rows("press", copies, press, "each number once", fix)
    present = [j for j, name in enumerate(taxels) if reader.has(name)]
    check_counts(reader, meta.sensor, counts[:, present].T, whole=False)
    branch = presses.column("branch")
    if branch is not None:
        bad = ~np.isin(branch.astype(str), ["up", "down", ""])
        reader.sheet.bad_rows("branch", bad, branch, '"up", "down" or nothing')
    for earlier, later in pairwise(name for name in TIMES if name in presses.columns):
        before, after = presses.columns[earlier], presses.columns[later]
        reader.sheet.bad_rows(later, after < before, after, f"a time not before {earlier}", CORRECT_OR_EMPTY)
    return presses


def frames_from(table: RawTable, meta: DatasetMeta, presses: Presses | None) -> Frames:
    """Return the frames of a table; add problems to the table's findings.

    ``presses`` are those of the dataset, None if they could not be read.
    """
    reader, taxels = ColumnReader(table), meta.sensor.taxel_columns()
    _require(reader, OF_FRAMES, taxels, "frame", "Leave the file out.")
    press = reader.whole("press", "a whole number, 0 or more, or -1 where nothing touches", low=-1)
    phase = _phase(reader)
    unmeasured = (phase == IDLE) | math.isinf(meta.position.sigma_m)
    optional = reader.optional(OPTIONAL, {*OF_FRAMES, *reader.taxel_columns(taxels)})
    own = {
        "press": press,
        "phase": phase,
        "time_s": reader.checked("time_s", ANY, may_be_nan=False),
        "force_n": reader.checked("force_n", ANY, may_be_nan=False),
        "position_m": reader.checked_matrix(POSITION, ANY, may_be_nan=unmeasured),
    }
    present = [j for j, name in enumerate(taxels) if reader.has(name)]
    if table.is_large:
        # Read and check one column at a time; later uses read the column from the file.
        check_counts(reader, meta.sensor, (reader.numbers(taxels[j]) for j in present), whole=True)
        again = ColumnReader(table)
        columns = LazyColumns([name for name, _ in optional], partial(again.optional_column, known=OPTIONAL))
        frames = Frames.from_file(LazyColumns(taxels, again.numbers), columns, **own)
    else:
        counts = reader.matrix(taxels)
        frames = Frames(**own, counts=counts, columns=dict(optional))
        check_counts(reader, meta.sensor, counts[:, present].T, whole=True)
    back = np.diff(frames.time_s, prepend=frames.time_s[:1]) < 0
    fix = "Sort them; time runs on from press to press and does not restart."
    reader.sheet.bad_rows("time_s", back, frames.time_s, "frames ordered in time over the whole session", fix)
    if reader.has("press"):
        _check_presses(reader, frames, presses)
    return frames


def _require(
    reader: ColumnReader, names: tuple[str, ...], taxels: tuple[str, ...], row: str, fix: str
) -> None:
    reader.require(names)
    reader.require(taxels)
    if not reader.rows:
        reader.sheet.findings.error(reader.sheet.file, f"at least one {row}", "no rows", fix)


def _normals(reader: ColumnReader) -> np.ndarray | None:
    present = [name for name in NORMAL if reader.has(name)]
    if not present:
        return None
    reader.require(NORMAL)
    normals = reader.checked_matrix(NORMAL, ANY)
    if len(present) == 3:
        given, names = np.isfinite(normals), ", ".join(NORMAL)
        partly = given.any(axis=1) & ~given.all(axis=1)
        fix = "Give all three, or leave the cells empty."
        reader.sheet.bad_rows(names, partly, normals, "all three, or none", fix)
        length = np.linalg.norm(normals, axis=1)
        wrong = given.all(axis=1) & (np.abs(length - 1) > 0.01)
        reader.sheet.bad_rows(names, wrong, length, "a vector of length 1", "Divide by its length.")
    return normals


def _phase(reader: ColumnReader) -> np.ndarray:
    """Return indices into PHASES, shape (rows,); an unknown word is reported and reads as idle."""
    if not reader.has("phase"):
        return np.zeros(reader.rows, dtype=np.int8)
    codes, words = {word: i for i, word in enumerate(PHASES)}, reader.text("phase")
    phase = np.fromiter((codes.get(word, -1) for word in words), np.int8, reader.rows)
    reader.sheet.bad_rows("phase", phase < 0, words, f"one of {', '.join(PHASES)}")
    return np.where(phase < 0, np.int8(IDLE), phase)


def _check_presses(reader: ColumnReader, frames: Frames, presses: Presses | None) -> None:
    if reader.has("phase"):
        bad = (frames.press == -1) & (frames.phase != IDLE)
        fix = "Give the press, or set the phase to idle."
        words = reader.text("phase") if bad.any() else []
        reader.sheet.bad_rows("phase", bad, words, '"idle" where press is -1', fix)
    if presses is not None:
        unknown = (frames.press >= 0) & ~np.isin(frames.press, presses.press)
        fix = "Add the press to that table, or take its frames out."
        reader.sheet.bad_rows("press", unknown, frames.press, "a press of the table of presses", fix)


NO_INTEGERS = 'Set integer = false, or baseline = "subtracted" if the level at rest was taken off.'

NOT_WHOLE = "[sensor] integer = false"

DEAD_STRETCH = 3
"""Number of successive rows of NaN from which a taxel counts as dead for a part of the session; fewer are lost
readings."""

MOST_LOST = 0.05
"""Largest fraction of lost readings: devices drop single ones; above it the table is incomplete (set by eye)."""


def check_counts(
    reader: ColumnReader, sensor: SensorSpec, columns: Iterable[FloatArray], *, whole: bool
) -> None:
    """Report problems of the counts (rows,) of each taxel column that is present.

    ``whole`` is true for single readings (frames), which must be whole numbers if the converter rounds.
    """
    names = [name for name in sensor.taxel_columns() if reader.has(name)]
    stray, infinite, outside, broken = (BadCells() for _ in range(4))
    dead, partly = np.zeros(len(names), dtype=bool), np.zeros(len(names), dtype=bool)
    missing_in_row = np.zeros(reader.rows, dtype=np.int64)
    low, high = _bounds(sensor)
    for j, (name, counts) in enumerate(zip(names, columns, strict=True)):
        missing = np.isnan(counts)
        dead[j] = missing.all()
        missing_in_row += missing
        if missing.any() and not dead[j]:
            stretches = long_stretches(missing, DEAD_STRETCH)
            partly[j] = stretches.any()
            stray.add(name, missing & ~(stretches | reader.is_reported(name)), counts)
        infinite.add(name, ~is_number(counts) & ~missing, counts)
        outside.add(name, np.isfinite(counts) & ((counts < low) | (counts > high)), counts)
        if whole and sensor.integer and sensor.baseline == "raw":
            broken.add(name, np.isfinite(counts) & (counts != np.rint(counts)), counts)
    sheet = reader.sheet
    lost = sum(stray.counts.values())
    # A row without any reading is not an image.
    empty = not dead.all() and (missing_in_row == len(names)).any()
    if lost and (empty or lost > MOST_LOST * reader.rows * len(names)):
        dead_is = f"a dead taxel is NaN throughout, or in {DEAD_STRETCH} or more successive rows"
        sheet.bad_cells(stray, f"a number of counts ({dead_is})", GIVE_OR_DROP)
    elif lost:
        got = f"none in {lost} of {reader.rows * len(names)} cells"
        sheet.findings.warn(sheet.file, "a reading of every taxel in every row", got, "Taken as lost there.")
    for which, when, where in (
        (dead, "nothing but NaN", ""),
        (partly, "NaN for a part of the session", " there"),
    ):
        if which.any():
            got = f"{when} from {first_of((names[j] for j in np.flatnonzero(which)), 6)}"
            sheet.findings.warn(sheet.file, "counts from every taxel", got, f"Taken as dead{where}.")
    sheet.bad_cells(infinite, "a finite number of counts", GIVE_OR_DROP)
    expected = f"counts within [{low:g}, {high:g}] (value_min, value_max)"
    sheet.bad_cells(outside, expected, "Correct value_min and value_max, or the counts.")
    expected = "whole numbers, as [sensor] integer = true says"
    sheet.bad_cells(broken, expected, NO_INTEGERS, code="unit_suspect", mapping=NOT_WHOLE)


def _bounds(sensor: SensorSpec) -> tuple[float, float]:
    """Return the smallest and largest possible counts; with a subtracted rest level only their span is known."""
    low = -np.inf if sensor.value_min is None else sensor.value_min
    high = np.inf if sensor.value_max is None else sensor.value_max
    return (low, high) if sensor.baseline == "raw" else (low - high, high - low)


def long_stretches(mask: BoolArray, length: int) -> BoolArray:
    """Return the cells of ``mask``, shape (rows,), that belong to a run of at least ``length``."""
    result = np.zeros_like(mask)
    starts_at = len(mask) - length + 1
    if starts_at < 1:
        return result
    starts = np.logical_and.reduce([mask[k : starts_at + k] for k in range(length)])
    for k in range(length):
        result[k : starts_at + k] |= starts
    return result
