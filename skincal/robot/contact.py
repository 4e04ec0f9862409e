"""The contact inferred from the joints: where the indenter touches, with what force, and how far away it is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skincal.errors import WorkError
from skincal.model.arrays import FloatArray, as_floats
from skincal.robot.description import HandDescription, HandState
from skincal.robot.kinematics import Kinematics


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

    @property
    def total_n(self) -> FloatArray:
        """(K,) Size of the whole force: a hand that presses sideways presses, too [N]."""
        return as_floats(np.sqrt(self.force_n**2 + self.shear_u_n**2 + self.shear_v_n**2))


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
    q, tau = kinematics.angles(q_rad), kinematics.angles(tau_nm)
    radius = kinematics.description.indenter_radius_m if indenter_radius_m is None else indenter_radius_m
    out, known = contact_rows(kinematics, q, tau)
    if not known:
        raise WorkError(
            "contact force: expected fingers whose joints can push in all directions; got a stretched or folded "
            "posture in which a force does not show in the torques. Choose another pose of the fingers."
        )
    return JointContact(
        points_m=out[:, :3],
        normals=out[:, 3:6],
        centres_m=out[:, 6:9],
        gap_m=out[:, 9] - radius,
        force_n=out[:, 10],
        shear_u_n=out[:, 11],
        shear_v_n=out[:, 12],
    )


def contact_rows(kinematics: Kinematics, q_rad: FloatArray, tau_nm: FloatArray) -> tuple[FloatArray, bool]:
    """Return contacts as rows (K, 13) of ``skincal.robot.routine.contacts``, and whether their forces are known."""
    from skincal.robot.routine import SOUND, compiled

    out = np.empty((len(q_rad), 13))
    chains = kinematics.skin.arrays, kinematics.indenter.arrays
    arc_radius_m = kinematics.surface.arc_radius_m or math.inf
    status = compiled().contacts(q_rad, tau_nm, kinematics.give_rad_per_nm, *chains, arc_radius_m, out)
    return out, status == SOUND


def prepare_contacts(kinematics: Kinematics) -> None:
    """Compile what states are read with, or load it, before a hand is connected that has to be answered in time."""
    nothing = np.empty((0, len(kinematics.description.joints)))
    kinematics.frames(nothing)
    contact_from_joints(kinematics, nothing, nothing)


def joint_contact_force(description: HandDescription) -> Callable[[HandState], float]:
    """Return a function that computes the size of the contact force [N] of a state from joint angles and torques."""
    kinematics = Kinematics(description)
    prepare_contacts(kinematics)

    def force_n(state: HandState) -> float:
        return float(contact_from_joints(kinematics, state.q_rad, state.tau_nm).total_n[0])

    return force_n
