"""Detection of undeclared clipping points of a converter: readings that pile up at 0 or at their largest value."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from skincal.dataset.dataset import Dataset
from skincal.dataset.findings import Sheet
from skincal.model.arrays import FloatArray

CONVERTER_RANGE = "converter_range"
"""Code of the note."""

WRONG_WORDS = ("bytes_swapped", "counter_wrapped")
"""Codes of warnings about binary words that were read wrongly, so that the extreme readings mean nothing."""

PILED, BELOW = 4, 0.05
"""Readings at exactly the largest value are clipped if there are at least this many, and more than within this fraction
of the range below it, over which different loads would spread them; set by eye."""

STUCK = 0.5
"""Largest fraction of a taxel's readings at the largest value; above it the taxel is stuck and does not count."""

AT_ZERO = 0.1
"""Smallest fraction of readings of exactly 0, with none below, at which the converter clips at 0; set by eye."""


def converter_top(counts: FloatArray) -> float | None:
    """Return the upper clipping point of readings (K, J; NaN where not read) [counts]; None if they show none."""
    top = float(np.nanmax(counts, initial=-np.inf))
    at_top = counts == top
    at_top = at_top[:, at_top.sum(axis=0) <= STUCK * np.isfinite(counts).sum(axis=0)]
    low = top - BELOW * (top - float(np.nanmin(counts, initial=np.inf)))
    piled, below = int(at_top.sum()), int(((counts >= low) & (counts < top)).sum())
    return top if piled >= max(PILED, below + 1) else None


def clips_at_zero(columns: Iterable[FloatArray]) -> bool:
    """Return whether single readings, (N,) of each taxel, are never negative and often 0, as clipped noise is."""
    read, at_zero = 0, 0
    for counts in columns:
        if (counts < 0).any():
            return False
        read, at_zero = read + int(np.isfinite(counts).sum()), at_zero + int((counts == 0).sum())
    return at_zero > 0 and at_zero >= AT_ZERO * read


def with_converter_range(dataset: Dataset, sheet: Sheet) -> Dataset:
    """Return the dataset with undeclared clipping points that its readings show; add a note to the findings."""
    sensor, presses = dataset.meta.sensor, dataset.presses.counts
    if sensor.baseline != "raw" or any(one.code in WRONG_WORDS for one in sheet.findings.warnings):
        return dataset
    found = dict[str, float]()
    single = presses.T if dataset.frames is None else dataset.frames.taxel_columns()
    if sensor.value_min is None and not (presses < 0).any() and clips_at_zero(single):
        found["value_min"] = 0.0
    top = converter_top(presses) if sensor.value_max is None else None
    if top is not None and top > 0:
        found["value_max"] = top
    if not found:
        return dataset
    written = " and ".join(f"{name} = {value:g}" for name, value in found.items())
    expected = "[sensor] value_min and value_max where the converter clips"
    got = "readings that pile up at " + " and ".join(f"{value:g}" for value in found.values())
    fix = f"They are taken to be clipped there. If they are, write {written} in [sensor]."
    sheet.findings.note(sheet.file, expected, got, fix, code=CONVERTER_RANGE)
    assumed = (*dataset.meta.assumed, *(f"sensor.{name}" for name in found))
    return replace(dataset, meta=replace(dataset.meta, sensor=replace(sensor, **found), assumed=assumed))
