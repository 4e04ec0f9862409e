"""Contact points: their patch coordinates, and their motion while they are held. Pure numerics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray
from skincal.statistics import robust_sigma

if TYPE_CHECKING:
    from skincal.model import SensorPose, Surface


GRID = 81
"""Number of grid points along each side of the patch, from which the search on a mesh starts."""

STEPS = 3
DIFFERENCE_M = 1e-5
"""Step of the finite differences [m]."""


def patch_coordinates(
    surface: Surface, pose: SensorPose, points_m: ArrayLike, reach_m: float = 0.02
) -> FloatArray:
    """Return the patch coordinates ``(u, v)`` [m], shape (K, 2), of contact points (contract, section 1, inverted).

    The points are in the fingertip frame [m], shape (K, 3); those off the surface are projected, NaN stays NaN. The
    result is exact, except on a mesh, where the facets limit the accuracy, and ``reach_m`` is the largest distance of a
    point from the patch's centre [m].
    """
    points = np.asarray(points_m, dtype=np.float64)
    if not surface.is_uniform:
        return _nearest(surface, pose, points, reach_m)
    across, along = surface.unrolled(points, surface.wrap(pose, np.zeros((1, 2)))[0]).T
    cos, sin = np.cos(pose.alpha_rad), np.sin(pose.alpha_rad)
    return np.column_stack([across * cos + along * sin, along * cos - across * sin])


def _nearest(surface: Surface, pose: SensorPose, points: FloatArray, reach_m: float) -> FloatArray:
    """Return the coordinates of the nearest points: the best of a coarse grid, refined by Gauss-Newton steps."""
    from scipy.spatial import cKDTree

    side = np.linspace(-reach_m, reach_m, GRID)
    uv = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    nodes = surface.wrap(pose, uv)[0]
    on_surface = np.isfinite(nodes).all(axis=1)
    found = np.full((len(points), 2), np.nan)
    given = np.isfinite(points).all(axis=1)
    if not on_surface.any() or not given.any():
        return found
    near = uv[on_surface][cKDTree(nodes[on_surface]).query(points[given])[1]]
    for _ in range(STEPS):
        near = _refined(surface, pose, points[given], near)
    found[given] = near
    return found


def _refined(surface: Surface, pose: SensorPose, points: FloatArray, uv: FloatArray) -> FloatArray:
    """Return the coordinates after one Gauss-Newton step with finite differences; no step at the end of the patch."""
    here = surface.wrap(pose, uv)[0]
    moved = [surface.wrap(pose, uv + step)[0] for step in DIFFERENCE_M * np.eye(2)]
    slopes = np.stack([(there - here) / DIFFERENCE_M for there in moved], axis=2)
    whole = np.asarray(np.isfinite(slopes).all(axis=(1, 2)))
    slopes[~whole] = np.eye(3, 2)
    step = np.einsum("kij,kj->ki", np.linalg.pinv(slopes), points - here)
    return np.where(whole[:, None], uv + step, uv)


SMALLEST_M: Final = 1e-4
"""Smallest movement of a contact that slides, for any accuracy of its position [m]."""

FEWEST_SAMPLES: Final = 4
"""Smallest number of samples of a hold from which their noise is estimated."""

PARTS: Final = 8
"""Length of a hold over the length of the smoothing window of its positions."""

NOISE_SIGMAS: Final = 6.0
"""Extent of a smoothed path of pure noise, in standard deviations (simulated: 1 in 1000 exceeds it)."""


def sample_noise_m(holds: Sequence[FloatArray]) -> float:
    """Return the standard deviation of a single position (as a vector) [m], the median over holds, each (n, 3)."""
    found: list[float] = []
    for position in holds:
        if len(position) >= FEWEST_SAMPLES and np.isfinite(position).all():
            # Differences of neighbours are noise alone, since a slide is slow.
            apart = np.diff(position, axis=0)
            found.append(float(np.linalg.norm([robust_sigma(axis) for axis in apart.T])) / np.sqrt(2))
    return float(np.median(found)) if found else 0.0


def slide_m(position_m: FloatArray, noise_m: float) -> float:
    """Return the extent of a contact's path in its hold (n, 3) [m]; NaN for unknown positions.

    It is corrected for ``noise_m``, the standard deviation of a single position (:func:`sample_noise_m`).
    """
    path, width = _path(position_m)
    if len(path) < 2:
        return float("nan")
    noise = NOISE_SIGMAS * noise_m / np.sqrt(width)
    return max(float(np.linalg.norm(np.ptp(path, axis=0))) - noise, 0.0)


def rests(position_m: FloatArray, still_m: float, noise_m: float) -> tuple[int, int]:
    """Return the longest stretch ``[start, stop)`` of a hold (n, 3) in which the contact moves at most ``still_m``.

    The bound is corrected for noise as in :func:`slide_m`.
    """
    path, width = _path(position_m)
    allowed = still_m + NOISE_SIGMAS * noise_m / np.sqrt(width)
    best, start = (0, 0), 0
    for stop in range(1, len(path) + 1):
        while np.linalg.norm(np.ptp(path[start:stop], axis=0)) > allowed:
            start += 1
        if stop - start > best[1] - best[0]:
            best = start, stop
    return best[0], best[1] + width - 1 if best[1] else 0


def _path(position_m: FloatArray) -> tuple[FloatArray, int]:
    """Return the smoothed positions (m, 3) and the width of the window; no positions if they are unknown."""
    if len(position_m) < 2 or not np.isfinite(position_m).all():
        return np.zeros((0, 3)), 1
    width = max(1, len(position_m) // PARTS)
    total = np.cumsum(np.vstack([np.zeros(3), position_m]), axis=0)
    return (total[width:] - total[:-width]) / width, width
