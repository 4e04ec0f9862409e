"""Position estimate of the object from tactile images, for hands without a camera.

A tactile image tells a place, but roughly; commanded angles tell how far the object has rolled, but not from where, and
drift. So the way is what the commands say, moved by the mean of what the images say beyond it over :data:`SMOOTH_S`.
"""

from __future__ import annotations

import numpy as np

from skincal.deploy.record import Record
from skincal.envs.pinch import Pinch
from skincal.envs.sensing import Sensor
from skincal.model.arrays import FloatArray
from skincal.train.estimator import Estimator

IMAGE_S = 0.3
"""Images are averaged over so much time before places are told from them: noise bends what is told of one image [s]."""
COMMAND_S = 0.2
"""Commanded angles are averaged over so much time before: links follow steps of 0.1 s late, and smoothly [s]."""
SMOOTH_S = 1.5
"""Places are averaged over so much time, half before and half after: a run is drawn when it is over [s]."""
_LEAST_COUNTS = 10.0
"""Images with less than this in all tell no place [counts]."""
_FOLLOWED = 0.87
"""The part of a commanded movement that the links make, in simulation: the rest is friction's and the drives'."""
_PRIOR_M = 2e-3
"""Movements of this size, by the images, weigh as much as what is expected of the commands [m]."""


def estimated_places(record: Record, estimator: Estimator, pinch: Pinch, width_m: float) -> FloatArray:
    """Return places (T, 2) at every state of a run, patch coordinates [m]; NaN where the skin feels nothing.

    Args:
        record: of the run.
        estimator: for as many taxels as the hand has.
        pinch: the hand; the sensor is taken to be where it is by the description.
        width_m: of the object [m].
    """
    felt = record.centroids_m.sum(axis=1) >= _LEAST_COUNTS
    places = np.full((len(felt), 2), np.nan)
    if not felt.any():
        return places
    every_s = np.array([state.time_s for state in record.states])
    time_s = every_s[felt]
    seen = estimator(_mean(record.images_counts[felt], time_s, IMAGE_S))
    rolled = _mean(_rolled(record, pinch, width_m), every_s, COMMAND_S, after_s=0.0)[felt]
    # How much of what was commanded happened, by this run's own images.
    x, y = (way - _mean(way, time_s, 2 * SMOOTH_S) for way in (rolled, _mean(seen, time_s, SMOOTH_S / 4)))
    weight = len(x) * _PRIOR_M**2 * np.eye(2)
    gain = np.linalg.solve(x.T @ x + weight, x.T @ y + _FOLLOWED * weight)
    way = rolled @ gain
    places[felt] = way + _mean(seen - way, time_s, SMOOTH_S)
    return places


def _rolled(record: Record, pinch: Pinch, width_m: float) -> FloatArray:
    """Return the rolled distance (T, 2) if the links had followed their commands [m].

    Rolling between two surfaces it goes half as far as they move against each other.
    """
    radius = pinch.radius_m
    sensor = Sensor(radius, pinch.pose)
    skin, thumb = pinch.kinematics.frames(np.array([state.q_desired_rad for state in record.states]))
    ends = thumb.to_root(np.array([[0.0, pinch.thumb.length_m, 0.0]]))
    bases = skin.to_root(np.zeros((1, 3)))
    far, half = pinch.thumb.radius_m, width_m / 2
    # The thumb's end and the object's centre go round the finger's axis at different distances.
    round_it = (radius + width_m + far) / (2 * (radius + half))
    way: list[FloatArray] = []
    for end, base, turn in zip(ends, bases, skin.rotations, strict=True):
        inside = (end - base) @ turn
        across = radius * np.arctan2(inside[0], inside[2])
        way.append(sensor.turned(round_it * across, float(inside[1]) / 2))
    return np.array(way)


def _mean(
    values: FloatArray, time_s: FloatArray, width_s: float, *, after_s: float | None = None
) -> FloatArray:
    """Return the mean of values (T, n) over a window about each time (T,), half of it after unless told."""
    after = width_s / 2 if after_s is None else after_s
    low = np.searchsorted(time_s, time_s + after - width_s)
    high = np.searchsorted(time_s, time_s + after, side="right")
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    return (total[high] - total[low]) / (high - low)[:, None]


def estimate_error_m(record: Record, places_m: FloatArray) -> float | None:
    """Median distance [m] of estimated from true places while the policy acted; None where nobody knows the truth."""
    acting = np.array([phase == "acting" for phase in record.phases])
    apart = np.linalg.norm(places_m - record.places_m, axis=1)[acting]
    apart = apart[np.isfinite(apart)]
    return float(np.median(apart)) if apart.size else None
