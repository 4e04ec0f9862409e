"""Conversion of the tables of a file to :class:`Presses` and :class:`Frames`; every violation is reported."""

from __future__ import annotations

import math
from functools import partial
from itertools import pairwise

import numpy as np

from skincal.covariates import ANY, NORMAL, POSITION, TIMES
from skincal.dataset.columns import CORRECT_OR_EMPTY, NO_FORCE, OPTIONAL, ColumnReader, repeated
from skincal.dataset.count_checks import check_counts
from skincal.dataset.spec import DatasetMeta
from skincal.dataset.table_file import RawTable
from skincal.dataset.tables import IDLE, PHASES, Frames, LazyColumns, Presses

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
    """Report required columns that are missing, and a table without rows."""
    reader.require(names)
    reader.require(taxels)
    if not reader.rows:
        reader.sheet.findings.error(reader.sheet.file, f"at least one {row}", "no rows", fix)


def _normals(reader: ColumnReader) -> np.ndarray | None:
    """Return the measured normals, shape (K, 3), NaN where not measured; None without such columns."""
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
    """Report frames with contact but without press, and frames of presses that are not in the table of presses."""
    if reader.has("phase"):
        bad = (frames.press == -1) & (frames.phase != IDLE)
        fix = "Give the press, or set the phase to idle."
        words = reader.text("phase") if bad.any() else []
        reader.sheet.bad_rows("phase", bad, words, '"idle" where press is -1', fix)
    if presses is not None:
        unknown = (frames.press >= 0) & ~np.isin(frames.press, presses.press)
        fix = "Add the press to that table, or take its frames out."
        reader.sheet.bad_rows("press", unknown, frames.press, "a press of the table of presses", fix)
