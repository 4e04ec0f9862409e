"""The upper end of a converter that nobody has declared: readings that pile up at their largest value."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.dataset.dataset import Dataset
from skincal.dataset.findings import Sheet
from skincal.model.arrays import FloatArray

CONVERTER_TOP = "converter_top"
"""Code of the note."""

PILED, BELOW = 4, 0.05
"""Readings that have the largest value exactly are a pile if they are so many, and more than lie within this part of
the range below it, where loads that differ would spread them; set by eye."""

STUCK = 0.5
"""A taxel that has the largest value in more than this part of its readings is stuck there."""


def converter_top(counts: FloatArray) -> float | None:
    """The value (counts) that readings (K, J; NaN where not read) pile up at, or None."""
    top = float(np.nanmax(counts, initial=-np.inf))
    at_top = counts == top
    at_top = at_top[:, at_top.sum(axis=0) <= STUCK * np.isfinite(counts).sum(axis=0)]
    low = top - BELOW * (top - float(np.nanmin(counts, initial=np.inf)))
    piled, below = int(at_top.sum()), int(((counts >= low) & (counts < top)).sum())
    return top if piled >= max(PILED, below + 1) else None


def with_converter_top(dataset: Dataset, sheet: Sheet) -> Dataset:
    """Return the dataset with the upper end of its converter, where it is not declared and readings show it."""
    sensor = dataset.meta.sensor
    top = (
        None
        if sensor.value_max is not None or sensor.baseline != "raw"
        else converter_top(dataset.presses.counts)
    )
    if top is None or top <= (sensor.value_min if sensor.value_min is not None else -np.inf):
        return dataset
    sheet.findings.note(
        sheet.file,
        "[sensor] value_max where the converter clips",
        f"{int((dataset.presses.counts == top).sum())} readings of {top:g} exactly, and fewer just below",
        f"They are taken to be clipped. If they are, write value_max = {top:g} in [sensor].",
        code=CONVERTER_TOP,
    )
    assumed = (*dataset.meta.assumed, "sensor.value_max")
    return replace(
        dataset, meta=replace(dataset.meta, sensor=replace(sensor, value_max=top), assumed=assumed)
    )
