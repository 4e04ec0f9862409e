"""The tables of a dataset from a recording and the spans of its presses. Pure numerics."""

from __future__ import annotations

import numpy as np
import pandas as pd

from skincal.covariates import NORMAL, POSITION, TIMES
from skincal.dataset import HOLD, IDLE, LOAD, PHASES, UNLOAD, Frames, Presses
from skincal.imports.recording import BoolArray, Column, Cut, FloatArray, Recording, Series, Span
from skincal.imports.targets import LABELS

OWN = ("press", "phase", "time_s", "force_n", *POSITION)


def presses_of_rows(recording: Recording) -> Presses:
    """Return the presses of a recording with one row per press; without numbers they are counted from 0."""
    numbers = recording.columns.get("press")
    taken = ("press", "force_n", *POSITION, *NORMAL)
    return Presses(
        press=np.arange(len(recording)) if numbers is None else numbers.astype(np.int64),
        position_m=recording.vector(POSITION),
        force_n=recording.columns["force_n"],
        counts=recording.counts,
        normals=_normals(recording),
        columns={name: column for name, column in recording.columns.items() if name not in taken},
    )


def tables_of_series(recording: Recording, series: Series, cut: Cut) -> tuple[Presses, Frames]:
    """Return the hold means of every press, and the frames without samples of rejected spans."""
    press = np.full(len(series), -1, dtype=np.int64)
    phase = np.full(len(series), IDLE, dtype=np.int8)
    kept = np.ones(len(series), dtype=bool)
    for rejected in cut.rejected:
        kept[rejected.start : rejected.stop] = False
    # A sample without any reading is no image.
    kept &= np.isfinite(recording.counts).any(axis=1) | ~np.isfinite(recording.counts).any()
    for span in cut.spans:
        press[span.start : span.stop] = span.number
        phase[span.start : span.hold] = LOAD if span.rising else UNLOAD
        phase[span.hold : span.hold_stop] = HOLD
        phase[span.hold_stop : span.stop] = UNLOAD
    if series.phase is not None:
        phase = np.array([PHASES.index(word) for word in series.phase], dtype=np.int8)
    position = np.where((phase == IDLE)[:, None], np.nan, recording.vector(POSITION))
    columns = {name: column for name, column in recording.columns.items() if name not in OWN}
    frames = Frames(press, phase, series.time_s, series.force_n, position, recording.counts, columns)
    return _presses(recording, series, cut.spans, phase == HOLD), frames.select(kept)


def _presses(recording: Recording, series: Series, spans: tuple[Span, ...], held: BoolArray) -> Presses:
    """Return the presses of spans; ``held`` (M,) says which samples within their holds count."""
    rows = [np.arange(span.hold, span.hold_stop) for span in spans]
    rows = [row[held[row]] for row in rows]
    press, together = np.repeat(np.arange(len(spans)), [len(row) for row in rows]), np.concatenate(rows)

    def means(values: FloatArray) -> FloatArray:
        """Return means of measured values over each hold, (K,) or (K, columns); NaN where nothing was measured."""
        means = pd.DataFrame(values[together]).groupby(press).mean().reindex(range(len(spans))).to_numpy()
        return means[:, 0] if values.ndim == 1 else means

    marks = [(span.start, span.hold, span.hold_stop - 1, span.stop - 1) for span in spans]
    columns: dict[str, Column] = dict(zip(TIMES, series.time_s[np.array(marks)].T, strict=True))
    if any(span.branch for span in spans) and "branch" not in recording.columns:
        columns["branch"] = np.array([span.branch for span in spans], dtype=object)
    for name, column in recording.columns.items():
        if name not in (*OWN, *NORMAL):
            of_press = column.dtype == object or name in LABELS
            columns[name] = column[[span.hold for span in spans]] if of_press else means(column)
    normals = _normals(recording)
    if normals is not None:
        normals = means(normals)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0, length, np.nan)
    return Presses(
        press=np.array([span.number for span in spans], dtype=np.int64),
        position_m=means(recording.vector(POSITION)),
        force_n=means(series.force_n),
        counts=means(recording.counts),
        normals=normals,
        columns=columns,
    )


def _normals(recording: Recording) -> FloatArray | None:
    return recording.vector(NORMAL) if any(name in recording.columns for name in NORMAL) else None
