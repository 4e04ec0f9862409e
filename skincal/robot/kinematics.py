"""Forward kinematics of both fingers, for many joint angles at once.

All positions are in the frame of the URDF's root link unless a name says otherwise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from skincal.dataset.dataset import surface_of
from skincal.dataset.findings import Findings
from skincal.dataset.schema_errors import report
from skincal.errors import WorkError
from skincal.model.arrays import FloatArray
from skincal.robot.chain import Chain, TipFrames
from skincal.robot.description import HandDescription
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
