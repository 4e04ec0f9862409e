"""The ends of a converter that nobody has declared: readings that pile up at 0, or at their largest value."""

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
"""Codes of warnings after which the ends of readings are those of words that were read wrongly."""

PILED, BELOW = 4, 0.05
"""Readings that have the largest value exactly are a pile if they are so many, and more than lie within this part of
the range below it, where loads that differ would spread them; set by eye."""

STUCK = 0.5
"""A taxel that has the largest value in more than this part of its readings is stuck there."""

AT_ZERO = 0.1
"""A converter clips at 0 that gives nothing less, and 0 in this part of the readings; set by eye."""


def converter_top(counts: FloatArray) -> float | None:
    """The value (counts) that readings (K, J; NaN where not read) pile up at, or None."""
    top = float(np.nanmax(counts, initial=-np.inf))
    at_top = counts == top
    at_top = at_top[:, at_top.sum(axis=0) <= STUCK * np.isfinite(counts).sum(axis=0)]
    low = top - BELOW * (top - float(np.nanmin(counts, initial=np.inf)))
    piled, below = int(at_top.sum()), int(((counts >= low) & (counts < top)).sum())
    return top if piled >= max(PILED, below + 1) else None


def clips_at_zero(columns: Iterable[FloatArray]) -> bool:
    """Return whether single readings, of each taxel (N,), are never below 0 and often 0: noise goes to either side."""
    read, at_zero = 0, 0
    for counts in columns:
        if (counts < 0).any():
            return False
        read, at_zero = read + int(np.isfinite(counts).sum()), at_zero + int((counts == 0).sum())
    return at_zero > 0 and at_zero >= AT_ZERO * read


def with_converter_range(dataset: Dataset, sheet: Sheet) -> Dataset:
    """Return the dataset with the ends of its converter, where they are not declared and readings show them."""
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
