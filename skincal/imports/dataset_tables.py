"""The tables of a dataset from a recording and the spans of its presses. Pure numerics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skincal.covariates import NORMAL, POSITION, TIMES
from skincal.dataset import HOLD, IDLE, LOAD, PHASES, UNLOAD, Frames, Presses
from skincal.imports.recording import Column, Cut, FloatArray, Recording, Series, Span
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
    return _presses(recording, series, cut.spans), _frames(recording, series, cut)


def _frames(recording: Recording, series: Series, cut: Cut) -> Frames:
    press = np.full(len(series), -1, dtype=np.int64)
    phase = np.full(len(series), IDLE, dtype=np.int8)
    kept = np.ones(len(series), dtype=bool)
    for rejected in cut.rejected:
        kept[rejected.start : rejected.stop] = False
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
    return frames.select(kept)


def _presses(recording: Recording, series: Series, spans: tuple[Span, ...]) -> Presses:
    times = np.array([[series.time_s[i] for i in _marks(span)] for span in spans]).reshape(-1, len(TIMES))
    columns: dict[str, Column] = {name: times[:, i] for i, name in enumerate(TIMES)}
    if any(span.branch for span in spans) and "branch" not in recording.columns:
        columns["branch"] = np.array([span.branch for span in spans], dtype=object)
    for name, column in recording.columns.items():
        if name in (*OWN, *NORMAL):
            continue
        if column.dtype == object or name in LABELS:
            columns[name] = column[[span.hold for span in spans]]
        else:
            columns[name] = _means(column[:, None], spans, series)[:, 0]
    normals = _normals(recording)
    return Presses(
        press=np.array([span.number for span in spans], dtype=np.int64),
        position_m=_means(recording.vector(POSITION), spans, series),
        force_n=_means(series.force_n[:, None], spans, series)[:, 0],
        counts=_means(recording.counts, spans, series),
        normals=None if normals is None else _unit(_means(normals, spans, series)),
        columns=columns,
    )


def _marks(span: Span) -> tuple[int, int, int, int]:
    """Return the samples of the start, of the first and last of the hold, and of the end."""
    return span.start, span.hold, span.hold_stop - 1, span.stop - 1


def _means(values: FloatArray, spans: tuple[Span, ...], series: Series) -> FloatArray:
    """Return means of measured values over each hold, shape (presses, columns); NaN where nothing was measured."""
    means = np.full((len(spans), values.shape[1]), np.nan)
    for i, span in enumerate(spans):
        rows = values[span.hold : span.hold_stop]
        if series.phase is not None:
            rows = rows[series.phase[span.hold : span.hold_stop] == PHASES[HOLD]]
        given = np.isfinite(rows)
        count = given.sum(axis=0)
        total = np.where(given, rows, 0.0).sum(axis=0)
        means[i] = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)
    return means


def _normals(recording: Recording) -> FloatArray | None:
    return recording.vector(NORMAL) if any(name in recording.columns for name in NORMAL) else None


def _unit(vectors: FloatArray) -> FloatArray:
    length: NDArray[np.float64] = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.full_like(vectors, np.nan), where=length > 0)
