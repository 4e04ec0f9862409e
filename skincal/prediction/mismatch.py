"""The mismatch of predicted and measured counts, with and without the level at rest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skincal.dataset import Dataset, idle_means
from skincal.dataset.uniform_pressure import uniform_pressure, zero_load_levels
from skincal.fitting.observe import Observed, Readout, expected_counts, observe
from skincal.fitting.types import Bools, Floats


@dataclass(frozen=True)
class Mismatch:
    """Root mean square difference per taxel between measured and predicted counts, during contact.

    Attributes:
        rmse_counts: difference of the columns as they are. A prediction has no noise, but clipped noise lifts the mean
            of an untouched taxel slightly above 0, which counts as a difference.
        rmse_with_rest_counts: difference after the contributions of the session's noise and rest level are added to the
            prediction: comparable with the loss of a fit and with the noise.
    """

    rmse_counts: float
    rmse_with_rest_counts: float


def _readout(dataset: Dataset) -> Readout:
    sensor = dataset.meta.sensor
    return Readout(sensor.value_min, sensor.value_max, sensor.integer, sensor.baseline == "subtracted")


def observed_images(dataset: Dataset, left_counts: Floats | float = 0.0) -> Observed:
    """Return the measured images as unclipped values above rest.

    The rest level comes from idle frames if there are enough, else from the presses that do not touch a taxel. Uniform
    pressure touches all taxels; then the level is extrapolated to zero force.

    Args:
        dataset: dataset of the presses.
        left_counts: (J,) contribution of memory to the idle frames, which is subtracted [counts].
    """
    idle = idle_means(dataset)
    if idle is None and uniform_pressure(dataset):
        idle = zero_load_levels(dataset)
    return observe(dataset.presses.counts, _readout(dataset), None if idle is None else idle - left_counts)


def within_range(dataset: Dataset, values: Floats) -> Floats:
    """Return the values (N, J) clipped to the range of the dataset's converter, not rounded [counts]."""
    return replace(dataset.converter(), integer=False).apply(values)


def mismatch(
    dataset: Dataset,
    measured: Floats,
    predicted: Floats,
    contact: Bools,
    seen: Observed,
    level_counts: Floats | float = 0.0,
) -> Mismatch:
    """Return the mismatch of presses or frames.

    Args:
        dataset: dataset of the rows, for its converter.
        measured: (N, J) measured counts.
        predicted: (N, J) predicted counts.
        contact: (N,) True for the rows that are compared.
        seen: images with the session's noise and rest level.
        level_counts: (J,) rest level in the prediction, which the session's replaces [counts].
    """
    counts, values = measured[contact], predicted[contact]
    above_rest = values - np.maximum(level_counts, 0.0)
    if np.isfinite(seen.frame_sigma_counts):
        readout = _readout(dataset)
        above = seen.rest_counts + (readout.value_min or 0.0)
        with_rest = expected_counts(above_rest + above, seen.frame_sigma_counts, readout)
    else:
        with_rest = within_range(dataset, above_rest + np.nan_to_num(seen.rest_counts))
    return Mismatch(rms(counts - values), rms(counts - with_rest))


def rms(values: Floats) -> float:
    """Return the root mean square of the known values; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")
