"""Corrections when a dataset is read: impossible readings become NaN, clipping points that they show are assumed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from skincal.dataset.dataset import Dataset
from skincal.dataset.findings import Sheet
from skincal.dataset.uniform_pressure import uniform_pressure
from skincal.dataset.word_checks import CHANCE, load_from_images, load_log_odds
from skincal.model.arrays import BoolArray, FloatArray
from skincal.model.rest import levels_from_presses

IMPOSSIBLE = "impossible_readings"

_JUMP = 3.0
"""Smallest ratio of impossible readings per newton to all others; this and the next two numbers were set by eye."""

_LARGEST_FRACTION = 0.2
"""Largest fraction of impossible readings among the active ones."""

_FEWEST_ACTIVE = 20
"""Smallest number of active readings from which impossible ones can be recognised."""

LIT_SIGMAS = 4.0
"""Smallest value of an active reading above rest, in standard deviations of the noise."""


def impossible_readings(counts: FloatArray, force: FloatArray) -> BoolArray:
    """Return which readings (K, J) no load explains: a taxel that dropped out to full scale, or a corrupted word.

    A taxel carries at most the whole force. Its reading per newton therefore has an upper bound, and different
    positions and forces fill the range below it. Readings are impossible if they are rare, spread over taxels, and
    separated from all others by an empty gap. Where every image is a single taxel, high readings are not rare and are
    kept. ``counts`` are means of presses (K, J), NaN where not read, ``force`` theirs (K,) [N].
    """
    levels = levels_from_presses(counts)
    change = counts - levels.level
    with np.errstate(divide="ignore", invalid="ignore"):
        per_newton = np.where(force[:, None] > 0, change / force[:, None], np.nan)
    noise = max(float(np.nan_to_num(levels.scatter)), np.finfo(float).tiny)
    per_newton[~(change > LIT_SIGMAS * noise)] = np.nan
    ordered = np.sort(per_newton[np.isfinite(per_newton)])
    none = np.zeros(counts.shape, dtype=bool)
    if len(ordered) < _FEWEST_ACTIVE:
        return none
    first = int(np.ceil((1.0 - _LARGEST_FRACTION) * len(ordered)))
    jumps = np.flatnonzero(ordered[first:] > _JUMP * ordered[first - 1 : -1])
    if not len(jumps):
        return none
    high = np.nan_to_num(per_newton) >= ordered[first + jumps[0]]
    # If most of the high readings are of one taxel, that taxel has another gain.
    most = int(high.sum(axis=0).max())
    return none if most > max(1.0, 0.5 * high.sum()) else high


def drop_outs(counts: FloatArray, position_m: FloatArray, force: FloatArray) -> BoolArray:
    """Return which readings dropped out to full scale (K, J): the largest value, wherever the skin is pressed.

    A converter that clips reads its largest value where the load is high. ``counts`` are means of presses (K, J), at
    positions (K, 3) [m] and forces (K,) [N].
    """
    read = np.isfinite(counts)
    at_top = read & (counts == np.nanmax(counts, initial=-np.inf))
    below, none = counts[read & ~at_top], np.zeros(counts.shape, dtype=bool)
    if not below.size or at_top.sum(axis=0).max() > max(1.0, 0.5 * at_top.sum()):
        return none  # a taxel is stuck
    high = read & ~at_top & (counts > 0.5 * (below.min() + below.max()))
    load = load_from_images(position_m, force, counts)
    return at_top if load_log_odds(load, at_top, high, read) < np.log(CHANCE) else none


def drop_impossible(dataset: Dataset, sheet: Sheet) -> Dataset:
    """Return the dataset with impossible readings of presses and frames set to NaN; add a note to the findings.

    Under uniform pressure every press touches all taxels, so that no rest level is known; nothing is dropped.
    """
    presses = dataset.presses
    if uniform_pressure(dataset):
        return dataset
    overflowed = any(one.code == "counter_wrapped" for one in sheet.findings.warnings)
    dropped = np.zeros(presses.counts.shape, dtype=bool)
    if not overflowed:
        dropped = drop_outs(presses.counts, presses.position_m, presses.force_n)
    above = impossible_readings(np.where(dropped, np.nan, presses.counts), presses.force_n)
    impossible = dropped | above
    if not impossible.any():
        return dataset
    level = levels_from_presses(np.where(impossible, np.nan, presses.counts)).level
    cause, fix = "their words overflowed", "They are left out."
    if not overflowed:
        cause = "a taxel dropped out to full scale there"
        fix += " Check the connection of the sensor; leave such words empty where they are read."
    at_top, far = "at the largest value, wherever it is pressed", "far above all others, with a gap between"
    where = at_top if dropped.any() else far
    sheet.findings.note(
        sheet.file, "readings that a load can explain",
        f"{impossible.sum()} readings of {impossible.any(axis=1).sum()} presses {where}: {cause}", fix, code=IMPOSSIBLE,
    )  # fmt: skip
    frames = dataset.frames
    if frames is not None:
        limit = _limit(presses.counts - level, presses.force_n, impossible, frames.force_n)
        frames = frames.drop_above(limit + level)
    presses = replace(presses, counts=np.where(impossible, np.nan, presses.counts))
    return replace(dataset, presses=presses, frames=frames)


def _limit(change: FloatArray, force_n: FloatArray, impossible: BoolArray, frames_n: FloatArray) -> float:
    """Return the change from rest above which a reading of a frame is impossible [counts].

    Infinite if the largest force of the frames (M,) could explain the smallest impossible reading of the presses, whose
    ``change`` (K, J) is their counts above rest.
    """
    pressed = force_n > 0
    per_newton = np.where(impossible, np.nan, change)[pressed] / force_n[pressed, None]
    largest_possible = float(np.nanmax(per_newton)) * float(np.nanmax(frames_n, initial=0.0))
    smallest_impossible = float(np.nanmin(change[impossible]))
    return smallest_impossible if smallest_impossible > largest_possible else np.inf


CONVERTER_RANGE = "converter_range"

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
