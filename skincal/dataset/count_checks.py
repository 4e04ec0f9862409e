"""Checks of a table's counts: numbers within the converter's range, NaN only where a taxel is dead."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from skincal.dataset.columns import GIVE_OR_DROP, ColumnReader, is_number
from skincal.dataset.findings import BadCells
from skincal.dataset.spec import SensorSpec
from skincal.errors import first_of
from skincal.model.arrays import BoolArray, FloatArray

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
    """Report problems of the counts in the taxel columns that are present.

    Args:
        reader: the table.
        sensor: the sensor's description.
        columns: counts (rows,) of each taxel column that is present.
        whole: True for single readings (frames), which must be whole numbers if the converter rounds.
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
