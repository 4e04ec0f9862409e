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
    """Pose of the patch on the surface (paper, section II-B).

    Attributes:
        y_m: position of the centre along the axis [m].
        alpha_rad: rotation about the outward normal at the centre, right-handed [rad].
        beta_rad: angle of the centre around the axis, on a cylinder or a mesh [rad].
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
"""Smallest distance of the patch from the axis that is used to convert arc lengths to angles [m]."""


class Surface(ABC):
    """The fingertip's surface at rest. A new kind is one file in this folder.

    Points and normals are in the fingertip frame: origin on the axis, +y along it to the tip, +z out of the
    surface where beta = 0, x = y × z.
    """

    is_uniform: ClassVar[bool] = False
    """True if the surface is the same everywhere: it can be unrolled, and the patch can be moved instead of presses."""

    @property
    def arc_radius_m(self) -> float | None:
        """R of arc = R beta [m] if it is the same at every pose, else None. On a plane positions across are x."""
        return None

    def arc_radius_at(self, pose: SensorPose) -> float | None:
        """Return R of arc = R beta at the patch's centre [m], its distance from the axis; None on a plane."""
        centre = self.wrap(replace(pose, alpha_rad=0.0), np.zeros((1, 2)))[0][0]
        return float(np.hypot(centre[0], centre[2]))

    def moved_pose(self, pose: SensorPose, across_m: float) -> SensorPose:
        """Return a pose moved by a length [m] towards growing beta (on a plane towards +x)."""
        radius = self.arc_radius_at(pose)
        if radius is None:
            return replace(pose, x_m=pose.x_m + across_m)
        return replace(pose, beta_rad=pose.beta_rad + across_m / max(radius, _ON_AXIS_M))

    def unrolled(self, points_m: ArrayLike, about_m: ArrayLike) -> FloatArray:
        """Unroll points (K, 3) [m] about others, (1, 3) or (K, 3) [m].

        Returns:
            (K, 2): arcs across, within half a turn (on a plane differences of x), and differences along [m].

        Raises:
            TypeError: the surface is not uniform and cannot be unrolled as a whole.
        """
        raise TypeError(f"{type(self).__name__}: expected a surface that is the same everywhere")

    @property
    def depth_m(self) -> float:
        """The largest valid penetration [m]; beyond it a press goes through the finger."""
        return np.inf

    @abstractmethod
    def wrap(self, pose: SensorPose, uv_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Map points of the patch onto the surface.

        Args:
            pose: pose of the patch.
            uv_m: (N, 2) patch coordinates [m]: arc lengths from the centre along the patch's own axes.

        Returns:
            Points (N, 3) [m] and outward unit normals (N, 3). Rows are NaN beyond the edge of the surface, and beyond
            half a turn around it, where the patch would overlap itself.
        """

    @abstractmethod
    def normal_at(self, points_m: ArrayLike) -> FloatArray:
        """Return the outward unit normals (K, 3) at the surface points nearest to ``points_m`` (K, 3) [m]."""

    @abstractmethod
    def project(self, points_m: ArrayLike) -> FloatArray:
        """Return the surface points (K, 3) [m] nearest to ``points_m`` (K, 3) [m]."""

    def ball_stiffness(
        self, pose: SensorPose, radius_m: float, elasticity_pa_per_m: float, force_n: float
    ) -> float:
        """Return the secant stiffness, force over depth, of a ball pressed into the skin [N/m].

        For depths that are small compared with the radii, the skin model gives F = pi E sqrt(R1 R2) d², with the radii
        of the gap along and across the finger: 1/R1 = 1/r, 1/R2 = 1/r + 1/R.

        Args:
            pose: pose of the patch.
            radius_m: radius r of the ball [m].
            elasticity_pa_per_m: E [Pa/m].
            force_n: F [N].
        """
        arc_radius = self.arc_radius_at(pose) or np.inf
        across = 1 / (1 / radius_m + 1 / arc_radius)
        return float(np.sqrt(np.pi * elasticity_pa_per_m * np.sqrt(radius_m * across) * force_n))

    @abstractmethod
    def offset(self, points_m: ArrayLike, across_m: ArrayLike, along_m: ArrayLike) -> FloatArray:
        """Move points along the surface; return surface points (K, 3) [m].

        Args:
            points_m: (K, 3) points [m]; those off the surface are projected first.
            across_m: (K,) arc length towards growing beta (on a plane +x) [m].
            along_m: (K,) arc length towards +y [m].
        """

    def cell_areas(self, pose: SensorPose, uv_m: ArrayLike, size_m: ArrayLike) -> FloatArray:
        """Return the areas of the patch's cells on the surface.

        Args:
            pose: pose of the patch.
            uv_m: (N, 2) centres of the cells [m].
            size_m: (N, 2) edge lengths of the cells along u and v [m].

        Returns:
            (N,) areas [m²]. A developable surface preserves areas; others override this method.
        """
        return floats("size_m", size_m, (None, 2)).prod(axis=1)


def turned(pose: SensorPose, uv_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Rotate patch coordinates to arc lengths across and along the finger: (u cos a - v sin a, u sin a + v cos a).

    Args:
        pose: pose of the patch; only ``alpha_rad`` is used.
        uv_m: (N, 2) patch coordinates [m].

    Returns:
        Across (N,) and along (N,) [m], from the patch's centre.
    """
    u, v = floats("uv_m", uv_m, (None, 2)).T
    cos, sin = np.cos(pose.alpha_rad), np.sin(pose.alpha_rad)
    return u * cos - v * sin, u * sin + v * cos
