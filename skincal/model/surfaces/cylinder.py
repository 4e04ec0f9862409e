"""The cylindrical part of a fingertip, in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, as_floats, floats, positive
from skincal.model.surfaces.surface import SensorPose, Surface, turned


@dataclass(frozen=True)
class Cylinder(Surface):
    """A cylinder about the fingertip's y axis, without ends.

    A point is (R sin beta, y, R cos beta), its outward normal (sin beta, 0, cos beta).

    Attributes:
        radius_m: R [m].
    """

    radius_m: float
    is_uniform: ClassVar[bool] = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius_m", positive("cylinder radius_m", self.radius_m))

    @property
    def depth_m(self) -> float:
        """Penetration that reaches the axis [m]."""
        return self.radius_m

    @property
    def arc_radius_m(self) -> float:
        """The cylinder's radius R [m]."""
        return self.radius_m

    def arc_radius_at(self, pose: SensorPose) -> float:
        return self.radius_m

    def unrolled(self, points_m: ArrayLike, about_m: ArrayLike) -> FloatArray:
        # A point on the axis has beta = 0.
        points, about = as_floats(points_m), as_floats(about_m)
        turn = np.mod(self._beta(points) - self._beta(about) + np.pi, 2 * np.pi) - np.pi
        return np.column_stack([self.radius_m * turn, points[:, 1] - about[:, 1]])

    def wrap(self, pose: SensorPose, uv_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        across, along = turned(pose, uv_m)
        turn = np.where(np.abs(across) <= np.pi * self.radius_m, across / self.radius_m, np.nan)
        normals = _radial(pose.beta_rad + turn)
        points = self.radius_m * normals
        points[:, 1] = np.where(np.isnan(turn), np.nan, pose.y_m + along)
        normals[:, 1] = np.where(np.isnan(turn), np.nan, 0.0)
        return points, normals

    def normal_at(self, points_m: ArrayLike) -> FloatArray:
        return _radial(self._beta(floats("points_m", points_m, (None, 3), finite=False)))

    def project(self, points_m: ArrayLike) -> FloatArray:
        return self.offset(points_m, 0.0, 0.0)

    def offset(self, points_m: ArrayLike, across_m: ArrayLike, along_m: ArrayLike) -> FloatArray:
        points = floats("points_m", points_m, (None, 3), finite=False)
        moved = self.radius_m * _radial(self._beta(points) + as_floats(across_m) / self.radius_m)
        moved[:, 1] = points[:, 1] + as_floats(along_m)
        return moved

    @staticmethod
    def _beta(points: FloatArray) -> FloatArray:
        return np.arctan2(points[:, 0], points[:, 2])


def _radial(beta: FloatArray) -> FloatArray:
    """Return outward normals (N, 3) at angles (N,) around the axis [rad]."""
    out = np.zeros((len(beta), 3))
    np.sin(beta, out=out[:, 0])
    np.cos(beta, out=out[:, 2])
    return out
