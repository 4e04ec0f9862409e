"""The skin around the sensor's nominal place, as a surface that looks the same everywhere.

It only serves the grid, which finds starts for the continuous part of a fit, and allows the kernel tables of the
fast way. Contacts are placed by their arc lengths from the nominal centre; the pressure under an indenter is the
one there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from skincal.fitting.grid import MacroGrid
from skincal.fitting.lattice import square
from skincal.fitting.posterior import Bounds
from skincal.fitting.presses import solve_small
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Floats, Ints
from skincal.model import SensorPose, Surface
from skincal.model.arrays import FloatArray, floats

SKIN_M = 8e-3
"""Margin of the modelled skin around the taxels [m], as in :meth:`skincal.model.Patch.build`."""

_STEP_M = 0.5e-3
"""Step of the laid-out lattice [m]."""
_BEYOND_M = 6e-3
"""Arc lengths are tabled up to this distance beyond the skin [m]; presses further off load no taxel."""


@dataclass(frozen=True, eq=False)
class LocalSurface(Surface):
    """The surface as seen from one place: every patch is laid there.

    Attributes:
        surface: of any shape.
        centre: the place.
        half_m: extent along u and v; beyond it there is no surface [m].
    """

    surface: Surface
    centre: SensorPose
    half_m: float

    def wrap(self, pose: SensorPose, uv_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """See :meth:`Surface.wrap`; only the turn of the pose matters."""
        uv = floats("uv_m", uv_m, (None, 2))
        points, normals = np.full((len(uv), 3), np.nan), np.full((len(uv), 3), np.nan)
        near = (np.abs(uv) <= self.half_m).all(axis=1)
        points[near], normals[near] = self.surface.wrap(
            replace(self.centre, alpha_rad=pose.alpha_rad), uv[near]
        )
        return points, normals

    def normal_at(self, points_m: ArrayLike) -> FloatArray:
        """See :meth:`Surface.normal_at`."""
        return self.surface.normal_at(points_m)

    def project(self, points_m: ArrayLike) -> FloatArray:
        """See :meth:`Surface.project`."""
        return self.surface.project(points_m)

    def offset(self, points_m: ArrayLike, across_m: ArrayLike, along_m: ArrayLike) -> FloatArray:
        """See :meth:`Surface.offset`."""
        return self.surface.offset(points_m, across_m, along_m)


@dataclass(frozen=True, eq=False)
class LocalPlaces:
    """Presses by arc lengths from the sensor's nominal centre, and the map to the coordinates of the fit.

    Attributes:
        surface: around that centre.
        place_m: (M, 2) contact positions across and along of every press of the session [m].
        centre_m: (2,) the nominal centre, in the coordinates of the fit [m].
        metric: (2,) arc length per unit of those coordinates, across and along.
    """

    surface: LocalSurface
    place_m: Floats
    centre_m: Floats
    metric: Floats

    @classmethod
    def of(cls, problem: FitProblem, points_m: Floats, centre_m: Floats) -> LocalPlaces | None:
        """Lay out the surface around the sensor's nominal centre (2,) [m]; None if the taxels do not fit on it there.

        ``points_m`` (M, 3) are the measured contact points of the session.
        """
        rig = problem.rig
        bounds = np.abs(rig.layout.bounds_m).max(axis=0)
        half = float(bounds.max()) + SKIN_M

        across, along = centre_m.tolist()
        uv = square(np.arange(-half - _BEYOND_M, half + _BEYOND_M + _STEP_M, _STEP_M))
        try:
            laid, _ = rig.surface.wrap(rig.pose(across, along, 0.0), uv)
            ends = [
                rig.surface.wrap(rig.pose(across + a, along + b, 0.0), np.zeros((1, 2)))[0][0]
                for a, b in ((_STEP_M, 0.0), (-_STEP_M, 0.0), (0.0, _STEP_M), (0.0, -_STEP_M))
            ]
        except ValueError:
            return None
        metric = np.array([np.linalg.norm(ends[0] - ends[1]), np.linalg.norm(ends[2] - ends[3])])
        there = np.isfinite(laid).all(axis=1)
        if not there.any():
            return None
        place = np.full((len(points_m), 2), np.nan)
        known = np.isfinite(points_m).all(axis=1)
        place[known] = centre_m + _to_arcs(laid[there], uv[there], points_m[known])
        local = LocalSurface(rig.surface, rig.pose(across, along, 0.0), half)
        return cls(local, place, centre_m, metric / (2 * _STEP_M))

    def problem(self, problem: FitProblem) -> FitProblem:
        """Return the problem on the uniform local surface."""
        across, along = self.place_m[problem.rows].T
        rig = replace(problem.rig, surface=self.surface)
        return replace(problem, across_m=across, along_m=along, rig=rig, contacts=None)

    def grid(self, grid: MacroGrid) -> MacroGrid:
        """Return the grid in arc lengths."""
        across, along = (
            self.centre_m[i] + self.metric[i] * (axis - self.centre_m[i])
            for i, axis in enumerate((grid.across_m, grid.y_m))
        )
        return replace(grid, across_m=across, y_m=along)

    def arcs(self, macro: Floats) -> Floats:
        """Return macro variables (..., 5) with the centre in arc lengths."""
        out = macro.copy()
        out[..., :2] = self.centre_m + self.metric * (macro[..., :2] - self.centre_m)
        return out

    def bounds(self, bounds: Bounds) -> Bounds:
        """Return the bounds of the macro variables with the centre in arc lengths."""
        return Bounds(self.arcs(bounds.low), self.arcs(bounds.high))

    def labels(self, macro: Floats) -> Floats:
        """Return macro variables (..., 5) with the centre in fit coordinates: the inverse of :meth:`arcs`."""
        out = macro.copy()
        out[..., :2] = self.centre_m + (macro[..., :2] - self.centre_m) / self.metric
        return out


def _to_arcs(laid_m: Floats, uv_m: Floats, points_m: Floats) -> Floats:
    """Return patch coordinates (M, 2) of points (M, 3), interpolated to first order from the nearest laid points."""
    from scipy.spatial import KDTree  # slow to import

    found = KDTree(laid_m).query(points_m, k=4)
    distance, near = np.asarray(found[0], dtype=np.float64), np.asarray(found[1], dtype=np.intp)
    # Affine weights, exact for points in the plane of the four neighbours, with the nearest one as
    # origin.
    first: Ints = near[:, 0]
    edges, arcs = laid_m[near[:, 1:]] - laid_m[first][:, None], uv_m[near[:, 1:]] - uv_m[first][:, None]
    gram = edges @ edges.transpose(0, 2, 1)
    gram += 1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-30 * np.eye(3)
    along = np.einsum("kei,ki->ke", edges, points_m - laid_m[first])
    weights = solve_small(gram, along)
    step = np.einsum("ke,kei->ki", weights, arcs)
    return uv_m[first] + np.where((distance[:, :1] < 2 * _STEP_M), step, 0.0)
