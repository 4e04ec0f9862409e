"""Readings that no load explains: they are left empty when a dataset is read, so that nothing after sees them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.dataset.dataset import Dataset
from skincal.dataset.findings import Sheet
from skincal.dataset.uniform_pressure import uniform_pressure
from skincal.dataset.word_checks import CHANCE, load_from_images, load_log_odds
from skincal.model.arrays import BoolArray, FloatArray
from skincal.model.rest import levels_from_presses

IMPOSSIBLE = "impossible_readings"
"""Code of the warning."""

_JUMP = 3.0
"""Impossible readings lie above all others by this factor at least, at the same force; this and the next two numbers
were set by eye."""

_SELDOM = 0.2
"""And they are at most this part of the readings that answer."""

_ANSWERING = 20
"""Fewer readings that answer do not tell what is possible."""

LIT_SIGMAS = 4.0
"""A reading answers that is so many times the noise above rest."""


def impossible_readings(counts: FloatArray, force: FloatArray) -> BoolArray:
    """Which readings (K, J) no load explains: a taxel that dropped out to full scale, or a word that was lost.

    A taxel carries the whole force at most, so what it reads for each newton has an upper end, and places and forces
    that differ fill the range below it. Readings for each newton that lie above all others with an empty gap between,
    seldom and on any taxel, are no images. Where all images are one taxel alone, those are no few of what answers.
    ``counts`` (K, J) are means of presses of some forces (K,) [N], NaN where not read.
    """
    found = levels_from_presses(counts)
    change = counts - found.level
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(force[:, None] > 0, change / force[:, None], np.nan)
    share[~(change > LIT_SIGMAS * max(float(np.nan_to_num(found.scatter)), np.finfo(float).tiny))] = np.nan
    ordered = np.sort(share[np.isfinite(share)])
    none = np.zeros(counts.shape, dtype=bool)
    if len(ordered) < _ANSWERING:
        return none
    first = int(np.ceil((1.0 - _SELDOM) * len(ordered)))
    jumps = np.flatnonzero(ordered[first:] > _JUMP * ordered[first - 1 : -1])
    if not len(jumps):
        return none
    high = np.nan_to_num(share) >= ordered[first + jumps[0]]
    # A taxel of its own gain reads high alone.
    most = int(high.sum(axis=0).max())
    return none if most > max(1.0, 0.5 * high.sum()) else high


def drop_outs(counts: FloatArray, position_m: FloatArray, force: FloatArray) -> BoolArray:
    """Which readings (K, J) have the largest value wherever it is pressed: taxels that dropped out to full scale.

    A converter that clips reads its largest value where other readings are high as well. ``counts`` are means of
    presses at places (K, 3) [m], with forces (K,) [N].
    """
    read = np.isfinite(counts)
    at_top = read & (counts == np.nanmax(counts, initial=-np.inf))
    below, none = counts[read & ~at_top], np.zeros(counts.shape, dtype=bool)
    if not below.size or at_top.sum(axis=0).max() > max(1.0, 0.5 * at_top.sum()):
        return none  # a taxel is stuck
    high = read & ~at_top & (counts > 0.5 * (below.min() + below.max()))
    load = load_from_images(position_m, force, counts)
    return at_top if load_log_odds(load, at_top, high, read) < np.log(CHANCE) else none


def without_impossible(dataset: Dataset, sheet: Sheet) -> Dataset:
    """Return the dataset with impossible readings empty, in frames as well; say how many in the findings of its sheet.

    Under uniform pressure no press leaves a taxel alone, and nothing is left out.
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
    cause, fix = (
        ("their words overflowed", "They are left out.")
        if overflowed
        else (
            "a taxel dropped out to full scale there",
            "They are left out. Look at the connection of the sensor; leave such words empty where they are read.",
        )
    )
    where = (
        "at the largest value, wherever it is pressed"
        if dropped.any()
        else "far above all others, with nothing between"
    )
    sheet.findings.note(
        sheet.file, "readings that some load explains",
        f"{impossible.sum()} readings of {impossible.any(axis=1).sum()} presses {where}: {cause}", fix, code=IMPOSSIBLE,
    )  # fmt: skip
    frames = dataset.frames
    if frames is not None:
        limit = _limit(presses.counts - level, presses.force_n, impossible, frames.force_n)
        frames = frames.below(limit + level)
    presses = replace(presses, counts=np.where(impossible, np.nan, presses.counts))
    return replace(dataset, presses=presses, frames=frames)


def _limit(change: FloatArray, force_n: FloatArray, impossible: BoolArray, frames_n: FloatArray) -> float:
    """Return the change from rest from which on a frame's reading is impossible, infinite where forces allow it."""
    pressed = force_n > 0
    each = np.where(impossible, np.nan, change)[pressed] / force_n[pressed, None]
    most = float(np.nanmax(each)) * float(np.nanmax(frames_n, initial=0.0))
    least = float(np.nanmin(change[impossible]))
    return least if least > most else np.inf
