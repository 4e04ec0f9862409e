"""``frames.parquet`` or ``.csv``: columns into :class:`Frames`, with every violation reported."""

from __future__ import annotations

import math

import numpy as np

from skincal.dataset.columns import ANY, OPTIONAL, POSITION, ColumnReader
from skincal.dataset.count_checks import check_counts
from skincal.dataset.spec import DatasetMeta
from skincal.dataset.table_file import RawTable
from skincal.dataset.tables import IDLE, PHASES, Frames, Presses

REQUIRED = ("press", "phase", "time_s", "force_n", *POSITION)


def frames_from(table: RawTable, meta: DatasetMeta, presses: Presses | None) -> Frames:
    """Takes the frames out of a table as read; what is wrong is added to the table's findings.

    Args:
        table: the table as read.
        meta: what ``dataset.toml`` says.
        presses: the presses that the frames belong to; None where they could not be read.
    """
    reader = ColumnReader(table)
    taxels = meta.sensor.taxel_columns()
    reader.require(REQUIRED)
    reader.require(taxels)
    if not table.rows:
        reader.sheet.findings.error(reader.sheet.file, "at least one frame", "no rows", "Leave the file out.")
    press = reader.whole("press", "a whole number, 0 or more, or -1 where nothing touches", low=-1)
    phase = _phase(reader)
    unmeasured = (phase == IDLE) | math.isinf(meta.position.sigma_m)
    counts = reader.matrix(taxels)
    frames = Frames(
        press=press,
        phase=phase,
        time_s=reader.checked("time_s", ANY, may_be_nan=False),
        force_n=reader.checked("force_n", ANY, may_be_nan=False),
        position_m=np.column_stack([reader.checked(name, ANY, may_be_nan=unmeasured) for name in POSITION]),
        counts=counts,
        columns=reader.optional(OPTIONAL, {*REQUIRED, *(taxels or reader.taxel_columns())}),
    )
    check_counts(reader, meta.sensor, counts, whole=True)
    _check_order(reader, frames)
    if reader.has("press"):
        _check_presses(reader, frames, presses)
    return frames


def _phase(reader: ColumnReader) -> np.ndarray:
    """Index into PHASES, shape (rows,); idle stands where it is none of them."""
    if not reader.has("phase"):
        return np.zeros(reader.rows, dtype=np.int8)
    # Only the few different words are compared, not a million cells.
    words, inverse = np.unique(reader.text("phase").astype(str), return_inverse=True)
    codes = np.array([PHASES.index(word) if word in PHASES else -1 for word in words], dtype=np.int8)
    phase = codes[inverse] if len(words) else np.zeros(reader.rows, dtype=np.int8)
    if (phase < 0).any():
        reader.sheet.bad_rows("phase", phase < 0, words[inverse].tolist(), f"one of {', '.join(PHASES)}")
    return np.where(phase < 0, np.int8(IDLE), phase)


def _check_order(reader: ColumnReader, frames: Frames) -> None:
    back = np.zeros(len(frames), dtype=bool)
    back[1:] = np.diff(frames.time_s) < 0
    fix = "Sort them; time goes on from press to press and does not begin anew."
    reader.sheet.bad_rows("time_s", back, frames.time_s, "frames ordered in time over the whole session", fix)


def _check_presses(reader: ColumnReader, frames: Frames, presses: Presses | None) -> None:
    nothing = frames.press == -1
    if reader.has("phase"):
        bad = nothing & (frames.phase != IDLE)
        names = np.array(PHASES)[frames.phase[bad][:3]]
        values = np.full(len(frames), "", dtype=object)
        values[np.flatnonzero(bad)[:3]] = names
        fix = "Name the press, or call the phase idle."
        reader.sheet.bad_rows("phase", bad, values, '"idle" where press is -1', fix)
    if presses is not None:
        strangers = (frames.press >= 0) & ~np.isin(frames.press, presses.press)
        fix = "Add the press to that table, or take its frames out."
        reader.sheet.bad_rows("press", strangers, frames.press, "a press of the table of presses", fix)
