"""The contact inferred from the joints: where the indenter touches, with what force, and how far away it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skincal.errors import WorkError
from skincal.model.arrays import FloatArray
from skincal.robot.description import HandDescription, HandState
from skincal.robot.kinematics import Kinematics

_SINGULAR = 1e6
"""Largest condition number of the normal equations for the force."""


@dataclass(frozen=True, eq=False)
class JointContact:
    """K contacts from joint angles and torques; positions and vectors are in the fingertip frame.

    Attributes:
        points_m: (K, 3) the point of the surface nearest to the indenter [m].
        normals: (K, 3) unit normals there, out of the fingertip and into the indenter.
        force_n: (K,) normal force [N], positive when pressing.
        shear_u_n: (K,) force on the skin towards growing beta (on a plane +x) [N].
        shear_v_n: (K,) force on the skin along +y [N].
        gap_m: (K,) distance of sphere and surface at rest [m]; negative where the sphere penetrates.
        centres_m: (K, 3) the sphere's centre [m].
    """

    points_m: FloatArray
    normals: FloatArray
    force_n: FloatArray
    shear_u_n: FloatArray
    shear_v_n: FloatArray
    gap_m: FloatArray
    centres_m: FloatArray

    def __len__(self) -> int:
        return len(self.force_n)


def contact_from_joints(
    kinematics: Kinematics, q_rad: ArrayLike, tau_nm: ArrayLike, *, indenter_radius_m: float | None = None
) -> JointContact:
    """Return the contacts of the indenter with the skin (Kasolowsky & Baeuml, IROS 2024, section III-A).

    At rest, and with gravity off or compensated, the drives hold the force F of the indenter on the skin:
    tau = J^T F for the finger with the indenter, tau = -J^T F for the finger with the skin, J the Jacobians of the
    contact point. Six torques determine three components by least squares, which for one finger alone is J^-T tau.
    While the fingers accelerate, their inertia disturbs the force.

    Args:
        kinematics: the hand.
        q_rad: measured joint angles (K, n) or (n,) [rad].
        tau_nm: measured joint torques, of the same shape [N m].
        indenter_radius_m: radius of the indenter [m]; default: that of the description.

    Returns:
        K contacts. A NaN in a row of the angles gives a row of NaN; a NaN in the torques gives a force of NaN.

    Raises:
        ValueError: shapes do not fit the hand.
        WorkError: the torques do not determine the force at these joint angles.
    """
    tau = kinematics.angles(tau_nm)
    q = kinematics.link_angles(q_rad, np.where(np.isfinite(tau), tau, 0.0))
    skin, indenter = kinematics.frames(q)
    centres = skin.to_tip(indenter.origins_m)
    radius = kinematics.description.meta.indenter.radius_m if indenter_radius_m is None else indenter_radius_m
    assert radius is not None
    points, normals, height = kinematics.surface.nearest(centres)
    at = skin.to_root(points)
    push, hold = kinematics.indenter.jacobian(indenter, at), kinematics.skin.jacobian(skin, at)
    torques = (tau[:, kinematics.indenter.columns], tau[:, kinematics.skin.columns])
    force = (_force(push, hold, *torques)[:, None] @ skin.rotations)[:, 0]
    across = np.stack([normals[:, 2], np.zeros(len(q)), -normals[:, 0]], axis=1)
    return JointContact(
        points_m=points,
        normals=normals,
        force_n=-(force * normals).sum(axis=1),
        shear_u_n=(force * across).sum(axis=1),
        shear_v_n=force[:, 1],
        gap_m=height - radius,
        centres_m=centres,
    )


def joint_contact_force(description: HandDescription) -> Callable[[HandState], float]:
    """Return a function that computes the size of the contact force [N] of a state from joint angles and torques.

    It is the full force, not only its normal part: a hand that presses sideways presses, too.
    """
    kinematics = Kinematics(description)

    def force_n(state: HandState) -> float:
        contact = contact_from_joints(kinematics, state.q_rad, state.tau_nm)
        parts = (contact.force_n[0], contact.shear_u_n[0], contact.shear_v_n[0])
        return float(sum(part * part for part in parts) ** 0.5)

    return force_n


def _force(push: FloatArray, hold: FloatArray, tau_push: FloatArray, tau_hold: FloatArray) -> FloatArray:
    """Return the force on the skin (K, 3) [N], root frame: least squares of both fingers' torques."""
    square = push @ np.swapaxes(push, 1, 2) + hold @ np.swapaxes(hold, 1, 2)
    right = (push @ tau_push[..., None] - hold @ tau_hold[..., None])[..., 0]
    known = np.asarray(np.isfinite(square).all(axis=(1, 2)))
    if not known.all():
        square = np.where(known[:, None, None], square, np.eye(3))
        right = np.where(known[:, None], right, np.nan)
    try:
        inverse = np.asarray(np.linalg.inv(square), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise _hidden() from error
    # For eigenvalues l of a positive matrix, sum l times sum 1 / l bounds the ratio of the largest to the smallest.
    # Rounding may give a singular matrix a negative eigenvalue.
    spread = _trace(square) * _trace(inverse)
    if not np.all((spread > 0) & (spread <= _SINGULAR)):
        raise _hidden()
    return (inverse @ right[..., None])[..., 0]


def _trace(matrices: FloatArray) -> FloatArray:
    return matrices[:, 0, 0] + matrices[:, 1, 1] + matrices[:, 2, 2]


def _hidden() -> WorkError:
    return WorkError(
        "contact force: expected fingers whose joints can push in all directions; got a stretched or folded "
        "posture in which a force does not show in the torques. Choose another pose of the fingers."
    )
