"""Which taxels answered a press: the level at rest, and what lies clearly above it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.dataset import Dataset
from skincal.dataset.tables import IDLE

ACTIVE_COUNTS = 5.0
"""How far above its level at rest a taxel must be to count as active [counts]."""

ACTIVE_SIGMAS = 6.0
"""The same in standard deviations of the noise at rest, for values that are no counts."""

REST_IN_DOUBT = (
    "Without frames at rest the level at rest is taken from the presses, and some taxels then rest far above the "
    "others: if all presses light the same taxels alike, add frames at rest (phase idle), or press at other places"
)
"""What to do where :func:`rest_in_doubt` says so."""

FEWEST_IDLE = 20
"""Idle frames that are needed to take the level at rest from them."""


def rest_levels(dataset: Dataset) -> NDArray[np.float64]:
    """Return the level of each taxel at rest.

    It is the median over the idle frames; where there are none, the mean of the dark readings over the presses,
    most of which do not reach a given taxel. Counts whose level at rest has been taken off rest at 0.

    Args:
        dataset: the data.

    Returns:
        Levels [counts], shape (J,); NaN for a taxel that is dead throughout.
    """
    if dataset.meta.sensor.baseline == "subtracted":
        return np.zeros(dataset.meta.sensor.taxels)
    levels = _of_idle_frames(dataset, np.nanmedian)
    if levels is None:
        from skincal.model.rest import rest_from_presses

        return rest_from_presses(dataset.presses.counts)[0]
    return levels


def rest_in_doubt(dataset: Dataset) -> bool:
    """Whether the level at rest may be that of taxels which every press lights alike.

    It is taken from the presses where there are too few idle frames; that of a taxel then should not stand clearly
    above that of most others. Presses that all lie at one place, with one force, make it do so.
    """
    if dataset.meta.sensor.baseline == "subtracted" or _idle(dataset) is not None:
        return False
    levels = rest_levels(dataset)
    levels = levels[np.isfinite(levels)]
    return bool(len(levels)) and float(levels.max() - np.median(levels)) > ACTIVE_COUNTS


def idle_means(dataset: Dataset) -> NDArray[np.float64] | None:
    """Return the mean counts of untouched taxels, which clipping lifts above their level at rest where there is noise.

    Args:
        dataset: the data.

    Returns:
        Means [counts], shape (J,), NaN for a taxel that is dead throughout; None where there are too few idle frames.
    """
    return _of_idle_frames(dataset, np.nanmean)


def noise_at_rest(dataset: Dataset) -> float:
    """Return the standard deviation of an untouched taxel about its level [counts], the median over the taxels; 0 if clipped.

    It is that of single frames where there are idle ones, else that of the lower readings of the presses.
    """
    spreads = _of_idle_frames(dataset, _low_spread)
    if spreads is None:
        counts = dataset.presses.counts
        spreads = np.array([_low_spread(c) for c in counts.T if np.isfinite(c).any()])
    alive = spreads[np.isfinite(spreads)]
    return float(np.median(alive)) if alive.size else 0.0


def _low_spread(counts: NDArray[np.float64]) -> np.floating:
    """Return the standard deviation of the lower half of readings, by two quantiles that lie 1.03 sigmas apart if normal."""
    middle, low = np.nanquantile(counts, (0.4, 0.1))
    return (middle - low) / 1.028


def active_threshold(dataset: Dataset) -> float:
    """How far above its level at rest a taxel counts as active: five counts, less where all values are small.

    Values in volts, or in shares of full scale, never reach five: there it is six sigmas of the noise at rest.
    """
    apart = dataset.presses.counts - rest_levels(dataset)
    top = float(np.nanmax(apart)) if np.isfinite(apart).any() else 0.0
    if top > ACTIVE_COUNTS or dataset.meta.sensor.unit == "counts":
        return ACTIVE_COUNTS
    return max(ACTIVE_SIGMAS * noise_at_rest(dataset), 1e-3 * max(top, 0.0))


def _idle(dataset: Dataset) -> NDArray[np.bool_] | None:
    """Which frames are idle (M,); None where there are too few."""
    frames = dataset.frames
    if frames is None or np.sum(idle := frames.phase == IDLE) < FEWEST_IDLE:
        return None
    return idle


def _of_idle_frames(
    dataset: Dataset, statistic: Callable[[NDArray[np.float64]], np.floating]
) -> NDArray[np.float64] | None:
    """Return a statistic of each taxel's counts over the idle frames (J,), NaN for a dead one; None where they are too few."""
    idle = _idle(dataset)
    if idle is None or dataset.frames is None:
        return None
    columns = (counts[idle] for counts in dataset.frames.taxel_columns())
    return np.array([statistic(c) if np.isfinite(c).any() else np.nan for c in columns], dtype=np.float64)


def active_taxels(dataset: Dataset, threshold_counts: float = ACTIVE_COUNTS) -> NDArray[np.bool_]:
    """Which taxels answered which press: those above their level at rest by more than a threshold.

    Args:
        dataset: the data.
        threshold_counts: the threshold [counts].

    Returns:
        Shape (K, J); a dead taxel (NaN) never answers.
    """
    return dataset.presses.counts - rest_levels(dataset) > threshold_counts
