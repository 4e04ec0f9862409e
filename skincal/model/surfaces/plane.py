"""A flat pad, in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, as_floats, floats
from skincal.model.surfaces.surface import SensorPose, Surface, turned


@dataclass(frozen=True)
class Plane(Surface):
    """The plane z = 0 with outward normal +z, without an edge."""

    is_uniform: ClassVar[bool] = True

    def arc_radius_at(self, pose: SensorPose) -> None:
        return None

    def unrolled(self, points_m: ArrayLike, about_m: ArrayLike) -> FloatArray:
        return (as_floats(points_m) - as_floats(about_m))[:, :2]

    def wrap(self, pose: SensorPose, uv_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        across, along = turned(pose, uv_m)
        points = np.column_stack([pose.x_m + across, pose.y_m + along, np.zeros_like(along)])
        return points, self.normal_at(points)

    def normal_at(self, points_m: ArrayLike) -> FloatArray:
        return np.tile([0.0, 0.0, 1.0], (len(floats("points_m", points_m, (None, 3), finite=False)), 1))

    def project(self, points_m: ArrayLike) -> FloatArray:
        return self.offset(points_m, 0.0, 0.0)

    def offset(self, points_m: ArrayLike, across_m: ArrayLike, along_m: ArrayLike) -> FloatArray:
        points = floats("points_m", points_m, (None, 3), finite=False)
        return np.column_stack(
            [points[:, 0] + as_floats(across_m), points[:, 1] + as_floats(along_m), np.zeros(len(points))]
        )
