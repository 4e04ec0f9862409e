"""Sites on the mounted patch, and postures of the hand over them: angles by height, torques per force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from skincal.collect.plan import CollectOptions
from skincal.dataset import DatasetMeta
from skincal.dataset.dataset import layout_of, pose_of, surface_of
from skincal.dataset.placement import patch_coordinates
from skincal.model import SensorPose, Surface, TaxelLayout
from skincal.model.arrays import FloatArray
from skincal.robot import Kinematics, place_indenter

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
        return self.surface.arc_radius_at(self.pose) is None

    def place(self, uv_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return points (K, 3) [m] and outward normals (K, 3) of sites (K, 2) [m]; NaN beyond the surface."""
        return self.surface.wrap(self.pose, np.reshape(np.asarray(uv_m, dtype=np.float64), (-1, 2)))

    def site_at(self, across: float, y_m: float) -> tuple[float, float]:
        """Return the site (u, v) [m] at a position on the surface; NaN for NaN.

        Args:
            across: beta [rad], on a plane x [m].
            y_m: along the finger [m].
        """
        if not np.isfinite([across, y_m]).all():
            return float("nan"), float("nan")
        there = SensorPose(y_m, 0.0, x_m=across) if self.pose_is_plane else SensorPose(y_m, 0.0, across)
        point, _ = self.surface.wrap(there, np.zeros((1, 2)))
        u, v = patch_coordinates(self.surface, self.pose, point)[0].tolist()
        return round(u, 9), round(v, 9)


HEIGHTS = 7
"""Number of heights at which the angles are solved; they are interpolated in between."""


@dataclass(frozen=True, eq=False)
class Posture:
    """Posture of the hand over one site, with the finger with the skin at rest.

    Attributes:
        heights_m: ascending heights of the indenter above the skin's nominal surface (H,) [m].
        links_rad: angles of the links at these heights (H, n) [rad].
        torque_m: torques of the joints per newton of normal force (n,) [N m/N].
        give_rad: lead of the commanded angles over the links, per newton of normal force, of shear along u and
            of shear along v (n, 3) [rad/N].
        stiffness_n_per_m: stiffness of both fingers together along the normal, from commanded angles to the skin [N/m].
        point_m: the site, fingertip frame (3,) [m].
        normal: outward normal there (3,).
    """

    heights_m: FloatArray
    links_rad: FloatArray
    torque_m: FloatArray
    give_rad: FloatArray
    stiffness_n_per_m: float
    point_m: FloatArray
    normal: FloatArray

    def links_at(self, height_m: float) -> FloatArray:
        """Return the angles of the links at a height, (n,) [rad]."""
        heights = self.heights_m
        step = heights[1] - heights[0]
        place = min(max((height_m - heights[0]) / step, 0.0), len(heights) - 1.0)
        i = min(int(place), len(heights) - 2)
        share = place - i
        return (1 - share) * self.links_rad[i] + share * self.links_rad[i + 1]

    def command(self, height_m: float, force_n: FloatArray) -> FloatArray:
        """Return the commanded angles (n,) [rad] at which a hand without friction presses with a force at a height.

        Args:
            height_m: height of the indenter above the skin [m].
            force_n: normal force and shears along u and v (3,) [N].
        """
        return self.links_at(height_m) + self.give_rad @ force_n


@dataclass(frozen=True, eq=False)
class Fingers:
    """Model of the fingers from which postures are computed."""

    kinematics: Kinematics
    mount: Mount

    def posture(
        self,
        site: tuple[float, float],
        skin_rad: ArrayLike,
        options: CollectOptions,
        indenter_radius_m: float | None = None,
        start_rad: FloatArray | None = None,
    ) -> Posture:
        """Return the posture over a site.

        Args:
            site: patch coordinates [m].
            skin_rad: angles of the finger with the skin [rad].
            options: how deep and how high the indenter goes.
            indenter_radius_m: radius of the sphere [m]; None: the hand's own.
            start_rad: angles of the links from which those of the posture are searched (n,) [rad]; None: home.

        Raises:
            WorkError: the site is out of reach.
        """
        kinematics, hand = self.kinematics, self.kinematics.description
        points, normals = self.mount.place([site])
        q = np.array(hand.home_rad if start_rad is None else start_rad, dtype=np.float64)
        q[kinematics.skin.columns] = skin_rad
        heights = np.linspace(-options.search_m, options.clearance_m, HEIGHTS)
        radius_m = indenter_radius_m or hand.indenter_radius_m
        links = np.empty((HEIGHTS, len(q)))
        for i in reversed(range(HEIGHTS)):
            q = place_indenter(kinematics, points[0] + (radius_m + heights[i]) * normals[0], q)
            links[i] = q
        touching = int(np.argmin(np.abs(heights)))
        torques = self.unit_torques(links[touching], points[0], normals[0])
        soft = 1 / hand.gains.stiffness_nm_per_rad
        if hand.compliance_rad_per_nm is not None:
            soft = soft + hand.compliance_rad_per_nm
        give = np.reshape(soft, (-1, 1)) * torques
        stiffness = 1 / float(torques[:, 0] @ give[:, 0])
        return Posture(heights, links, torques[:, 0], give, stiffness, points[0], normals[0])

    def unit_torques(self, links_rad: FloatArray, point_m: FloatArray, normal: FloatArray) -> FloatArray:
        """Return the torques of all joints at rest for a force of 1 N on the skin at a point.

        Args:
            links_rad: angles of the links (n,) [rad].
            point_m: point of the force, fingertip frame (3,) [m].
            normal: outward normal there (3,).

        Returns:
            (n, 3) [N m/N], for forces against the normal, along u (round the finger) and along v (+y).
        """
        kinematics = self.kinematics
        skin, indenter = kinematics.skin_frames(links_rad), kinematics.indenter_frames(links_rad)
        at = skin.to_root(point_m[None])
        across = np.array([normal[2], 0.0, -normal[0]])
        forces = skin.rotations[0] @ np.stack([-normal, across, [0.0, 1.0, 0.0]], axis=1)
        return kinematics.torques(skin, indenter, at, at, forces)
