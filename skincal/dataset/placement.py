"""Patch coordinates of contact points: the inverse of the mapping from the patch to the fingertip frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray

if TYPE_CHECKING:
    from skincal.model import SensorPose, Surface


GRID = 81
"""Number of grid points along each side of the patch, from which the search on a mesh starts."""

STEPS = 3
"""Number of Gauss-Newton steps."""
DIFFERENCE_M = 1e-5
"""Step of the finite differences [m]."""


def patch_coordinates(
    surface: Surface, pose: SensorPose, points_m: ArrayLike, reach_m: float = 0.02
) -> FloatArray:
    """Return the patch coordinates of contact points (contract, section 1, solved for u and v).

    Args:
        surface: the surface.
        pose: pose of the patch on the surface.
        points_m: contact points, fingertip frame [m], shape (K, 3); those off the surface are projected.
        reach_m: largest distance of a point from the patch's centre on a surface that cannot be unrolled [m].

    Returns:
        ``(u, v)`` [m], shape (K, 2); NaN where a point is NaN. Exact, except on a mesh, where the facets limit the
        accuracy.
    """
    points = np.asarray(points_m, dtype=np.float64)
    if not surface.is_uniform:
        return _nearest(surface, pose, points, reach_m)
    (across, along), radius = surface.unrolled(points), surface.arc_radius_m
    if radius is None:
        across = across - pose.x_m
    else:
        across = radius * (np.mod(across / radius - pose.beta_rad + np.pi, 2 * np.pi) - np.pi)
    along, cos, sin = along - pose.y_m, np.cos(pose.alpha_rad), np.sin(pose.alpha_rad)
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
