"""Errors of a hand's measured contact positions that its joints cause."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.errors import WorkError
from skincal.model.arrays import FloatArray
from skincal.robot import Kinematics, contact_from_joints, place_indenter
from skincal.sim.truth import Truth

FORCE_N = 3.0
"""Force at which the error is evaluated [N]."""
_HALF_M = 0.006
_SIDE = 5


@dataclass(frozen=True, eq=False)
class PositionError:
    """Error of the contact position over a grid around the sensor's nominal centre, in the home pose.

    Attributes:
        mean_across_m: mean towards growing beta (on a plane +x) [m].
        mean_along_m: mean along +y [m].
        rms_m: root mean square of the length, the mean included [m].
        scatter_m: root mean square of the length about the mean [m].
    """

    mean_across_m: float
    mean_along_m: float
    rms_m: float
    scatter_m: float

    def as_dict(self) -> dict[str, float]:
        """Return plain numbers, for a JSON file."""
        return dict(vars(self))


def position_error(kinematics: Kinematics, truth: Truth) -> PositionError:
    """Return the position error caused by joint offsets, waves and the drives' true stiffness.

    Raises:
        WorkError: no point of the grid can be reached from the home pose.
    """
    errors = [
        error for place in _places(kinematics) if (error := _error_at(kinematics, truth, *place)) is not None
    ]
    if not errors:
        raise WorkError("simulated hand: expected a sensor that the indenter can reach from the home pose")
    found = np.array(errors)
    mean = found.mean(axis=0)
    return PositionError(
        mean_across_m=float(mean[0]),
        mean_along_m=float(mean[1]),
        rms_m=float(np.sqrt((found**2).sum(axis=1).mean())),
        scatter_m=float(np.sqrt(((found - mean) ** 2).sum(axis=1).mean())),
    )


def surface_error(radius_m: float | None, measured_m: FloatArray, true_m: FloatArray) -> FloatArray:
    """Return measured minus true points (K, 3) along the surface, a cylinder about y or the plane z = 0.

    Args:
        radius_m: radius of the cylinder [m]; None on a plane.
        measured_m: (K, 3) [m].
        true_m: (K, 3) [m].

    Returns:
        (K, 2) towards growing beta (on a plane +x) and along +y [m].
    """
    along = measured_m[:, 1] - true_m[:, 1]
    if radius_m is None:
        return np.stack([measured_m[:, 0] - true_m[:, 0], along], axis=1)
    turns = [np.arctan2(p[:, 0], p[:, 2]) for p in (measured_m, true_m)]
    return np.stack([radius_m * (turns[0] - turns[1]), along], axis=1)


def _places(kinematics: Kinematics) -> list[tuple[FloatArray, FloatArray]]:
    """Return points (3,) and normals (3,) of a grid around the nominal centre."""
    meta = kinematics.description.meta
    steps = np.linspace(-_HALF_M, _HALF_M, _SIDE)
    places: list[tuple[FloatArray, FloatArray]] = []
    for across in steps:
        for along in steps:
            y = meta.mount.y_m + along
            if meta.surface.radius_m is None:
                x = (meta.mount.x_m or 0.0) + across
                places.append((np.array([x, y, 0.0]), np.array([0.0, 0.0, 1.0])))
                continue
            beta = np.radians(meta.mount.beta_deg or 0.0) + across / meta.surface.radius_m
            normal = np.array([np.sin(beta), 0.0, np.cos(beta)])
            places.append((meta.surface.radius_m * normal + [0.0, y, 0.0], normal))
    return places


def _error_at(
    kinematics: Kinematics, truth: Truth, point: FloatArray, normal: FloatArray
) -> tuple[float, float] | None:
    """Return the error of the position, across and along [m]; None if the point is out of reach."""
    meta = kinematics.description.meta
    assert meta.indenter.radius_m is not None
    try:
        q = place_indenter(
            kinematics, point + meta.indenter.radius_m * normal, kinematics.description.home_rad
        )
    except WorkError:
        return None
    skin = kinematics.skin_frames(q)
    at, force = skin.to_root(point[None]), skin.rotations[0] @ (-FORCE_N * normal)
    tau = kinematics.torques(skin, kinematics.indenter_frames(q), at, at, force)
    measured = q
    if kinematics.description.compliance_rad_per_nm is not None:
        measured = q + tau / truth.joints.drive_stiffness_nm_per_rad
    found = contact_from_joints(kinematics, measured + truth.joints.angle_error_rad(measured), tau)
    along = float(found.points_m[0, 1] - point[1])
    if meta.surface.radius_m is None:
        return float(found.points_m[0, 0] - point[0]), along
    turn = np.arctan2(found.normals[0, 0], found.normals[0, 2]) - np.arctan2(normal[0], normal[2])
    return float(meta.surface.radius_m * turn), along
