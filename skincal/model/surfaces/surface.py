"""Interface of fingertip surfaces, and the pose of the sensor on them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, floats


@dataclass(frozen=True)
class SensorPose:
    """Place and turn of the patch on the surface (paper, section II-B).

    Attributes:
        y_m: position of the centre along the axis [m].
        alpha_rad: turn about the outward normal at the centre, right-handed [rad].
        beta_rad: position round the axis, on a cylinder or a mesh [rad].
        x_m: position across, on a plane [m].
    """

    y_m: float
    alpha_rad: float
    beta_rad: float = 0.0
    x_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("y_m", "alpha_rad", "beta_rad", "x_m"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"pose {name}: expected a finite number; got {getattr(self, name)!r}")


_ON_AXIS_M = 1e-4
"""A patch that lies nearer to the axis is turned as if it lay this far from it."""


class Surface(ABC):
    """The fingertip's surface at rest. Add a kind with one file beside this one.

    Points and normals are in the fingertip frame: origin on the axis, +y along it to the tip, +z out of the
    surface where beta = 0, x = y × z.
    """

    is_uniform: ClassVar[bool] = False
    """True if it is the same everywhere: it can be unrolled, and moving the patch is moving the presses."""

    @property
    def arc_radius_m(self) -> float | None:
        """R of arc = R beta [m], where it is the same at every pose; None on a plane, where positions across are x."""
        return None

    def arc_radius_at(self, pose: SensorPose) -> float | None:
        """Return R of arc = R beta at the patch's centre [m], its distance from the axis; None on a plane."""
        centre = self.wrap(replace(pose, alpha_rad=0.0), np.zeros((1, 2)))[0][0]
        return float(np.hypot(centre[0], centre[2]))

    def moved_pose(self, pose: SensorPose, across_m: float) -> SensorPose:
        """Return a pose moved along growing beta, on a plane along x, by a length [m]."""
        radius = self.arc_radius_at(pose)
        if radius is None:
            return replace(pose, x_m=pose.x_m + across_m)
        return replace(pose, beta_rad=pose.beta_rad + across_m / max(radius, _ON_AXIS_M))

    def unrolled(self, points_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return positions across, (K,) arcs from beta = 0 (on a plane x), and along, (K,) y, of points (K, 3) [m].

        Raises:
            TypeError: the surface is not uniform: it cannot be unrolled as a whole.
        """
        raise TypeError(f"{type(self).__name__}: expected a surface that is the same everywhere")

    @property
    def depth_m(self) -> float:
        """The penetration from which on a press is through what lies below the surface [m]."""
        return np.inf

    @abstractmethod
    def wrap(self, pose: SensorPose, uv_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Lay points of the patch on the surface.

        Args:
            pose: where the patch is.
            uv_m: (N, 2) patch coordinates [m]: arc lengths from the centre along the patch's own axes.

        Returns:
            Points (N, 3) [m] and outward unit normals (N, 3). Rows are NaN where the surface has no such place:
            beyond its edge, or round it by more than half a turn, where the patch would lie on itself.
        """

    @abstractmethod
    def normal_at(self, points_m: ArrayLike) -> FloatArray:
        """Return outward unit normals (K, 3) at the points of the surface nearest to ``points_m`` (K, 3) [m]."""

    @abstractmethod
    def project(self, points_m: ArrayLike) -> FloatArray:
        """Return the points of the surface (K, 3) [m] nearest to ``points_m`` (K, 3) [m]."""

    def ball_stiffness(
        self, pose: SensorPose, radius_m: float, elasticity_pa_per_m: float, force_n: float
    ) -> float:
        """Return the force over depth of a ball in the skin at some force [N/m].

        For depths that are small compared with the radii the skin model gives F = pi E sqrt(R1 R2) d², with R1 and R2
        the radii of the gap along and across: 1/R1 = 1/r, 1/R2 = 1/r + 1/R.
        """
        arc_radius = self.arc_radius_at(pose) or np.inf
        across = 1 / (1 / radius_m + 1 / arc_radius)
        return float(np.sqrt(np.pi * elasticity_pa_per_m * np.sqrt(radius_m * across) * force_n))

    @abstractmethod
    def offset(self, points_m: ArrayLike, across_m: ArrayLike, along_m: ArrayLike) -> FloatArray:
        """Move points along the surface; return points (K, 3) of the surface [m].

        Args:
            points_m: (K, 3) points [m]; those off the surface are projected first.
            across_m: (K,) arc length towards growing beta (on a plane +x) [m].
            along_m: (K,) arc length towards +y [m].
        """

    def cell_areas(self, pose: SensorPose, uv_m: ArrayLike, size_m: ArrayLike) -> FloatArray:
        """Return areas of the cells of the patch around its points, on the surface.

        Args:
            pose: where the patch is.
            uv_m: (N, 2) centres of the cells [m].
            size_m: (N, 2) edge lengths of the cells along u and v [m].

        Returns:
            (N,) areas [m²]. Wrapping keeps them on a surface that can be unrolled; others override this.
        """
        return floats("size_m", size_m, (None, 2)).prod(axis=1)


def turned(pose: SensorPose, uv_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return arc lengths across and along the finger of points of the patch (u cos a - v sin a, u sin a + v cos a).

    Args:
        pose: its ``alpha_rad`` is used.
        uv_m: (N, 2) patch coordinates [m].

    Returns:
        Across (N,) and along (N,) [m], from the patch's centre.
    """
    u, v = floats("uv_m", uv_m, (None, 2)).T
    cos, sin = np.cos(pose.alpha_rad), np.sin(pose.alpha_rad)
    return u * cos - v * sin, u * sin + v * cos
