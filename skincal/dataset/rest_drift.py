"""How far the level at rest right before each press lies from its mean over the session: drift, and re-zeroing."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.dataset import Dataset
from skincal.dataset.tables import IDLE

NEAREST: Final = 25
"""Idle frames right before a press that tell its level at rest."""

_FEWEST, _CLEAR = 5, 3.0
"""Presses that a variance needs; standard deviations above the lower bound from which nothing is clipped."""


def rest_drift(dataset: Dataset) -> NDArray[np.float64] | None:
    """Return by how much the level at rest of each taxel has moved when each press begins.

    The mean of the idle frames right before a press, less that of all presses (less 0, where the level has been
    subtracted), shrunk by the part of its variance that the noise of these frames explains (James and Stein). So
    nothing is taken off where nothing drifts.

    Returns:
        Shifts [counts], shape (K, J), 0 where they are not known or the converter clips; None without idle frames
        between presses.
    """
    frames, presses = dataset.frames, dataset.presses
    if frames is None:
        return None
    idle = frames.phase == IDLE
    spans = _idle_before(idle, frames.press, presses.press)
    known = np.array([len(rows) > 1 for rows in spans])
    if known.sum() < _FEWEST:
        return None
    many = np.array([len(rows) for rows in spans], dtype=np.float64)[known]
    rows = [span for span, is_known in zip(spans, known, strict=True) if is_known]
    sensor, shifts = dataset.meta.sensor, np.zeros(presses.counts.shape)
    low = -np.inf if sensor.value_min is None or sensor.baseline == "subtracted" else sensor.value_min
    for j, counts in enumerate(frames.taxel_columns()):
        parts = [counts[some] for some in rows]
        mean = np.array([part.mean() for part in parts])
        noise = float(np.median([part.var(ddof=1) for part in parts]))
        if not np.isfinite(mean).all():
            continue
        middle = 0.0 if sensor.baseline == "subtracted" else float(mean.mean())
        moved = max(float(np.mean((mean - middle) ** 2)) - float(np.mean(noise / many)), 0.0)
        if moved > 0 and mean.min() > low + _CLEAR * np.sqrt(noise):
            shifts[known, j] = (mean - middle) * moved / (moved + noise / many)
    if sensor.value_max is not None and sensor.baseline != "subtracted":
        shifts[presses.counts >= sensor.value_max] = 0.0
    return shifts


def _idle_before(
    idle: NDArray[np.bool_], press: NDArray[np.int64], numbers: NDArray[np.int64]
) -> list[NDArray[np.intp]]:
    """Return for each press the last idle frames in a row before it; none where other frames lie between."""
    touched = np.flatnonzero(~idle)
    known, first = np.unique(press[touched], return_index=True)
    begins = dict(zip(known.tolist(), touched[first].tolist(), strict=True))
    spans: list[NDArray[np.intp]] = []
    for number in numbers.tolist():
        begin = begins.get(number, 0)
        part = idle[max(begin - NEAREST, 0) : begin]
        gaps = np.flatnonzero(~part)
        spans.append(np.arange(begin - len(part) + (int(gaps[-1]) + 1 if len(gaps) else 0), begin))
    return spans
