"""Conversion of ``frames.parquet`` or ``.csv`` to :class:`Frames`; every violation is reported."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from skincal.covariates import ANY, POSITION
from skincal.dataset.columns import OPTIONAL, ColumnReader
from skincal.dataset.count_checks import check_counts
from skincal.dataset.spec import DatasetMeta
from skincal.dataset.table_file import RawTable
from skincal.dataset.tables import IDLE, PHASES, Frames, LazyColumns, Presses

REQUIRED = ("press", "phase", "time_s", "force_n", *POSITION)


def frames_from(table: RawTable, meta: DatasetMeta, presses: Presses | None) -> Frames:
    """Return the frames of a table; add problems to the table's findings.

    Args:
        table: the table.
        meta: content of ``dataset.toml``.
        presses: presses of the dataset; None if they could not be read.
    """
    reader = ColumnReader(table)
    taxels = meta.sensor.taxel_columns()
    reader.require(REQUIRED)
    reader.require(taxels)
    reader.require_rows("at least one frame", "Leave the file out.")
    press = reader.whole("press", "a whole number, 0 or more, or -1 where nothing touches", low=-1)
    phase = _phase(reader)
    unmeasured = (phase == IDLE) | math.isinf(meta.position.sigma_m)
    optional = reader.optional(OPTIONAL, {*REQUIRED, *(taxels or reader.taxel_columns())})
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
