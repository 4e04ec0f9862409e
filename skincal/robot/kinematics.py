"""Forward kinematics of both fingers, for many joint angles at once, and the contact inferred from the joints.

All positions are in the frame of the URDF's root link unless a name says otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skincal.dataset.dataset import surface_of
from skincal.dataset.findings import Findings
from skincal.dataset.schema_errors import report
from skincal.errors import WorkError
from skincal.model.arrays import FloatArray, as_floats
from skincal.robot.chain import Chain, TipFrames
from skincal.robot.description import HandDescription, HandState
from skincal.robot.urdf import read_urdf


class Kinematics:
    """Forward kinematics of the two tips, and the surface of the one with the skin; the URDF is read once.

    Attributes:
        description: the hand.
        skin: chain of the finger with the skin.
        indenter: chain of the finger with the indenter.
        surface: surface of the skin.
        give_rad_per_nm: compliance of the drives (n,) [rad/(N m)].

    Raises:
        InputError: the URDF is invalid, or contacts on such a surface cannot be found.
    """

    def __init__(self, description: HandDescription) -> None:
        findings, meta, joints = Findings(), description.meta, description.joints
        urdf = read_urdf(description.urdf, findings)
        # A driver may bring a description that was read from no file.
        report(meta.hand_violations(), findings, f"hand {description.name}")
        findings.raise_errors()
        assert urdf is not None
        give = description.compliance_rad_per_nm
        self.description, self.surface = description, surface_of(meta.surface, {})
        self.skin = Chain.of(urdf, description.skin_finger, joints)
        self.indenter = Chain.of(urdf, description.indenter_finger, joints)
        self.give_rad_per_nm: FloatArray = np.zeros(len(joints)) if give is None else np.array(give)

    def skin_frames(self, q_rad: ArrayLike) -> TipFrames:
        """Return the fingertip frames for joint angles (K, n) or (n,) [rad]."""
        return self.skin.frames(self.angles(q_rad))

    def indenter_frames(self, q_rad: ArrayLike) -> TipFrames:
        """Return the frames at the sphere's centre for joint angles (K, n) or (n,) [rad]."""
        return self.indenter.frames(self.angles(q_rad))

    def frames(self, q_rad: ArrayLike) -> tuple[TipFrames, TipFrames]:
        """Return the frames of the fingertip and at the sphere's centre for joint angles (K, n) or (n,) [rad]."""
        q = self.angles(q_rad)
        return self.skin.frames(q), self.indenter.frames(q)

    def link_angles(self, q_rad: ArrayLike, tau_nm: ArrayLike) -> FloatArray:
        """Return the link angles (K, n) [rad]: measured angles (K, n) less the give of the drives at torques (K, n)."""
        q = self.angles(q_rad)
        return q - self.give_rad_per_nm * self.angles(tau_nm)

    def torques(
        self,
        skin: TipFrames,
        indenter: TipFrames,
        on_skin_m: FloatArray,
        on_indenter_m: FloatArray,
        forces_n: FloatArray,
    ) -> FloatArray:
        """Return the torques at rest of all joints with which the fingers press on each other, (n,) or (n, F) [N m].

        Args:
            skin: frames of the fingertip, for one posture.
            indenter: frames of the other tip.
            on_skin_m: (1, 3) where the finger with the skin is pressed [m].
            on_indenter_m: (1, 3) where the other finger presses [m].
            forces_n: (3,) or (3, F) forces on the skin; like the points in the frame of the URDF's root [N].
        """
        tau = np.zeros((len(self.description.joints), *forces_n.shape[1:]))
        tau[self.indenter.columns] = self.indenter.jacobian(indenter, on_indenter_m)[0].T @ forces_n
        tau[self.skin.columns] = -self.skin.jacobian(skin, on_skin_m)[0].T @ forces_n
        return tau

    def angles(self, values: ArrayLike) -> FloatArray:
        """Return values (K, n) or (n,) as (K, n).

        Raises:
            ValueError: another number of joints.
        """
        # A copy: the compiled routine is compiled for arrays that can be written to, row by row.
        rows = np.array(values, dtype=np.float64, order="C", ndmin=2)
        count = len(self.description.joints)
        if rows.ndim != 2 or rows.shape[1] != count:
            raise ValueError(f"expected values of {count} joints; got shape {np.shape(values)}")
        return rows


TOLERANCE_M = 1e-7
"""Largest distance of the centre from its target [m]."""


def place_indenter(kinematics: Kinematics, centre_m: ArrayLike, q_rad: ArrayLike) -> FloatArray:
    """Return the joint angles (n,) [rad] at which the sphere's centre lies at a point of the fingertip frame.

    Damped Newton steps, clipped to the joint limits. The finger with the skin stays where it is.

    Args:
        kinematics: the hand.
        centre_m: (3,) target of the centre, fingertip frame [m].
        q_rad: (n,) angles of the links to start from [rad]; those of the skin's finger stay.

    Raises:
        WorkError: the point is out of reach within the joint limits.
    """
    from skincal.robot.routine import compiled

    limits = kinematics.description.limits
    target = np.asarray(centre_m, dtype=np.float64).reshape(3)
    q = np.array(q_rad, dtype=np.float64).reshape(-1)
    columns = kinematics.indenter.columns
    low, high = limits.lower_rad[columns], limits.upper_rad[columns]
    goal = kinematics.skin_frames(q).to_root(target[None])[0]
    best = compiled().reach(q, goal, kinematics.indenter.arrays, low, high, TOLERANCE_M)
    if best <= TOLERANCE_M:
        return q
    place = ", ".join(f"{1e3 * v:.1f}" for v in target)
    raise WorkError(
        f"inverse kinematics: expected a point that {kinematics.description.indenter_finger.name} can reach; got "
        f"({place}) mm in the fingertip frame, which it misses by {1e3 * best:.2f} mm within its joint limits. "
        "Choose another pose of the finger with the skin."
    )


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
