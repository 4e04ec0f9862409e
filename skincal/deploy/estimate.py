"""Where the object was by what the skin felt: for hands that no camera looks at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skincal.deploy.record import Record
from skincal.train.estimator import Estimator

FloatArray = NDArray[np.float64]

SMOOTH_S = 0.4
"""Estimates are averaged over so much time, half before and half after: a run is drawn when it is over [s]."""
_LEAST_COUNTS = 10.0
"""Images with less than this in all tell no place [counts]."""


def estimated_places(record: Record, estimator: Estimator) -> FloatArray:
    """Places (T, 2) at every state of a run, patch coordinates [m]; NaN where the skin feels nothing.

    Args:
        record: of the run.
        estimator: for as many taxels as the hand has.
    """
    images = record.centroids_m
    places = estimator(images)
    places[(images.sum(axis=1) < _LEAST_COUNTS)] = np.nan
    time_s = np.array([state.time_s for state in record.states])
    low = np.searchsorted(time_s, time_s - SMOOTH_S / 2)
    high = np.searchsorted(time_s, time_s + SMOOTH_S / 2, side="right")
    felt = np.isfinite(places).all(axis=1)
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(np.where(felt[:, None], places, 0.0), axis=0)])
    count = np.concatenate([[0], np.cumsum(felt)])
    number = (count[high] - count[low])[:, None]
    mean = np.divide(total[high] - total[low], number, out=np.full_like(places, np.nan), where=number > 0)
    return np.where(felt[:, None], mean, np.nan)


def estimate_error_m(record: Record, places_m: FloatArray) -> float | None:
    """Median distance [m] of estimated from true places while the policy acted; None where nobody knows the truth."""
    acting = np.array([phase == "acting" for phase in record.phases])
    apart = np.linalg.norm(places_m - record.places_m, axis=1)[acting]
    apart = apart[np.isfinite(apart)]
    return float(np.median(apart)) if apart.size else None
