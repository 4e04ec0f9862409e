"""Errors of a hand's measured contact positions that its joints cause."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.dataset.dataset import pose_of
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


def position_error(kinematics: Kinematics, truth: Truth) -> PositionError:
    """Return the position error caused by joint offsets, waves and the drives' true stiffness.

    Raises:
        WorkError: no point of the grid can be reached from the home pose.
    """
    errors = [
        error
        for place in zip(*_places(kinematics), strict=True)
        if (error := _error_at(kinematics, truth, *place)) is not None
    ]
    if not errors:
        raise WorkError("simulated hand: expected a sensor that the indenter can reach from the home pose")
    offsets = np.array(errors)
    mean = offsets.mean(axis=0)
    return PositionError(
        mean_across_m=float(mean[0]),
        mean_along_m=float(mean[1]),
        rms_m=float(np.sqrt((offsets**2).sum(axis=1).mean())),
        scatter_m=float(np.sqrt(((offsets - mean) ** 2).sum(axis=1).mean())),
    )


def _places(kinematics: Kinematics) -> tuple[FloatArray, FloatArray]:
    """Return points (P, 3) [m] and normals (P, 3) of a grid around the nominal centre."""
    surface, steps = kinematics.surface, np.linspace(-_HALF_M, _HALF_M, _SIDE)
    across, along = (axis.ravel() for axis in np.meshgrid(steps, steps, indexing="ij"))
    centre, _ = surface.wrap(pose_of(kinematics.description.meta.mount), np.zeros((1, 2)))
    points = surface.offset(np.repeat(centre, len(across), axis=0), across, along)
    return points, surface.normal_at(points)


def _error_at(
    kinematics: Kinematics, truth: Truth, point: FloatArray, normal: FloatArray
) -> tuple[float, float] | None:
    """Return the error of the position, across and along [m]; None if the point is out of reach."""
    hand = kinematics.description
    try:
        q = place_indenter(kinematics, point + hand.indenter_radius_m * normal, hand.home_rad)
    except WorkError:
        return None
    skin = kinematics.skin_frames(q)
    at, force = skin.to_root(point[None]), skin.rotations[0] @ (-FORCE_N * normal)
    tau = kinematics.torques(skin, kinematics.indenter_frames(q), at, at, force)
    measured = q
    if hand.compliance_rad_per_nm is not None:
        measured = q + tau / truth.joints.drive_stiffness_nm_per_rad
    contact = contact_from_joints(kinematics, measured + truth.joints.angle_error_rad(measured), tau)
    across, along = kinematics.surface.unrolled(contact.points_m, point[None])[0].tolist()
    return across, along
