"""Position estimate of the object from tactile images, for hands without a camera.

A tactile image gives an absolute but noisy position. Commanded angles give the rolled distance, which is smooth but
drifts and has no origin. The estimate is the path from the commands plus the mean difference of the image positions
from that path over :data:`SMOOTH_S` (a complementary filter).
"""

from __future__ import annotations

import numpy as np

from skincal.deploy.record import Record
from skincal.envs.pinch import Pinch
from skincal.envs.world import Sensor
from skincal.model.arrays import FloatArray
from skincal.train.estimator import Estimator

IMAGE_S = 0.3
"""Width of the window that averages images before the estimate: noise biases the estimate from one image [s]."""
COMMAND_S = 0.2
"""Width of the trailing window that averages commanded angles: links follow steps of 0.1 s with a smooth lag [s]."""
SMOOTH_S = 1.5
"""Width of the centred window that averages positions; it is not causal, as a run is evaluated at its end [s]."""
_LEAST_COUNTS = 10.0
"""Smallest sum of an image from which a position is estimated [counts]."""
_FOLLOWED = 0.87
"""Prior of the gain: fraction of a commanded movement that the links make in simulation. Friction and the compliance of
the drives take the rest."""
_PRIOR_M = 2e-3
"""Rms movement in the images at which the data weigh as much as the prior of the gain [m]."""


def estimate_positions(record: Record, estimator: Estimator, pinch: Pinch, width_m: float) -> FloatArray:
    """Estimate the object's position (T, 2) at every state of a run, in patch coordinates [m]; NaN without contact.

    Args:
        record: record of the run.
        estimator: position estimator for the hand's taxels.
        pinch: the hand; the sensor is assumed at the pose of the hand's description.
        width_m: width of the object [m].
    """
    in_contact = record.centroids_m.sum(axis=1) >= _LEAST_COUNTS
    places = np.full((len(in_contact), 2), np.nan)
    if not in_contact.any():
        return places
    every_s = np.array([state.time_s for state in record.states])
    time_s = every_s[in_contact]
    by_image = estimator(_moving_mean(record.images_counts[in_contact], time_s, IMAGE_S))
    commanded = _commanded_path(record, pinch, width_m)
    rolled = _moving_mean(commanded, every_s, COMMAND_S, after_s=0.0)[in_contact]
    # Regress image movements on commanded movements: the gain of this run, with a ridge prior.
    smooth = _moving_mean(by_image, time_s, SMOOTH_S / 4)
    x, y = (path - _moving_mean(path, time_s, 2 * SMOOTH_S) for path in (rolled, smooth))
    weight = len(x) * _PRIOR_M**2 * np.eye(2)
    gain = np.linalg.solve(x.T @ x + weight, x.T @ y + _FOLLOWED * weight)
    path = rolled @ gain
    places[in_contact] = path + _moving_mean(by_image - path, time_s, SMOOTH_S)
    return places


def _commanded_path(record: Record, pinch: Pinch, width_m: float) -> FloatArray:
    """Return the path (T, 2) of the object if the links had followed their commands [m].

    An object that rolls between two surfaces moves half as far as they move relative to each other.
    """
    radius = pinch.radius_m
    sensor = Sensor(radius, pinch.pose)
    skin, thumb = pinch.kinematics.frames(np.array([state.q_desired_rad for state in record.states]))
    ends = thumb.to_root(np.array([[0.0, pinch.thumb.length_m, 0.0]]))
    bases = skin.to_root(np.zeros((1, 3)))
    far, half = pinch.thumb.radius_m, width_m / 2
    # The thumb's end and the object's centre move around the finger's axis at different radii.
    ratio = (radius + width_m + far) / (2 * (radius + half))
    path: list[FloatArray] = []
    for end, base, turn in zip(ends, bases, skin.rotations, strict=True):
        inside = (end - base) @ turn
        across = radius * np.arctan2(inside[0], inside[2])
        path.append(sensor.turned(ratio * across, float(inside[1]) / 2))
    return np.array(path)


def _moving_mean(
    values: FloatArray, time_s: FloatArray, width_s: float, *, after_s: float | None = None
) -> FloatArray:
    """Return the mean of values (T, n) over a window around each time (T,) [s].

    The window extends ``after_s`` after each time; default: half of its width.
    """
    after = width_s / 2 if after_s is None else after_s
    low = np.searchsorted(time_s, time_s + after - width_s)
    high = np.searchsorted(time_s, time_s + after, side="right")
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    return (total[high] - total[low]) / (high - low)[:, None]


def estimate_error_m(record: Record, places_m: FloatArray) -> float | None:
    """Return the median error of estimated positions (T, 2) while the policy acted [m]; None without true positions."""
    apart = np.linalg.norm(places_m - record.places_m, axis=1)[record.is_acting]
    apart = apart[np.isfinite(apart)]
    return float(np.median(apart)) if apart.size else None
