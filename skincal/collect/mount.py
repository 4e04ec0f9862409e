"""Sites on the patch as points and normals of the fingertip, for the nominal pose of the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from skincal.dataset import DatasetMeta
from skincal.dataset.model_objects import layout_of, pose_of, surface_of
from skincal.dataset.placement import patch_coordinates
from skincal.model import Plane, SensorPose, Surface, TaxelLayout
from skincal.model.arrays import FloatArray

BEYOND_M = 0.02
"""Largest distance of a site from the taxels: farther out it is a typing error."""


@dataclass(frozen=True, eq=False)
class Mount:
    """The surface, with the patch at its nominal pose."""

    surface: Surface
    pose: SensorPose
    layout: TaxelLayout

    @classmethod
    def of(cls, meta: DatasetMeta) -> Self:
        """Return the mount of a hand from its datasets' metadata; the layout must be a grid."""
        return cls(surface_of(meta.surface, {}), pose_of(meta.mount), layout_of(meta.sensor, None))

    @property
    def reach_m(self) -> float:
        """Largest distance of a site from the patch's centre along u and along v [m]."""
        return float(np.abs(self.layout.bounds_m).max()) + BEYOND_M

    @property
    def pose_is_plane(self) -> bool:
        """True if a position is (x, y) instead of (beta, y)."""
        return isinstance(self.surface, Plane)

    def place(self, uv_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return points (K, 3) [m] and outward normals (K, 3) of sites (K, 2) [m]; NaN beyond the surface."""
        return self.surface.wrap(self.pose, np.reshape(np.asarray(uv_m, dtype=np.float64), (-1, 2)))

    def site_at(self, across: float, y_m: float) -> tuple[float, float]:
        """Return the site at a position on the surface.

        Args:
            across: beta [rad], on a plane x [m].
            y_m: along the finger [m].

        Returns:
            Patch coordinates (u, v) [m]; NaN for NaN.
        """
        if not np.isfinite([across, y_m]).all():
            return float("nan"), float("nan")
        there = SensorPose(y_m, 0.0, x_m=across) if self.pose_is_plane else SensorPose(y_m, 0.0, across)
        point, _ = self.surface.wrap(there, np.zeros((1, 2)))
        u, v = patch_coordinates(self.surface, self.pose, point)[0].tolist()
        return round(u, 9), round(v, 9)
