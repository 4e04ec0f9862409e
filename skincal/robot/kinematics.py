"""Forward kinematics of both fingers, for many joint angles at once.

All positions are in the frame of the URDF's root link unless a name says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from skincal.dataset.findings import Findings
from skincal.model.arrays import FloatArray
from skincal.robot.chain import Chain, TipFrames
from skincal.robot.description import HandDescription
from skincal.robot.pair import ChainPair
from skincal.robot.urdf import read_urdf


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Forward kinematics of the two tips.

    Build it with ``Kinematics(description)``; the URDF is read once.
    """

    description: HandDescription
    skin: Chain = field(init=False, repr=False)
    indenter: Chain = field(init=False, repr=False)
    _pair: ChainPair = field(init=False, repr=False)

    def __post_init__(self) -> None:
        findings = Findings()
        urdf = read_urdf(self.description.urdf, findings)
        findings.raise_errors()
        assert urdf is not None
        joints = self.description.joints
        skin = Chain.of(urdf, self.description.skin_finger, joints)
        indenter = Chain.of(urdf, self.description.indenter_finger, joints)
        object.__setattr__(self, "skin", skin)
        object.__setattr__(self, "indenter", indenter)
        object.__setattr__(self, "_pair", ChainPair.of(skin, indenter))

    def skin_frames(self, q_rad: ArrayLike) -> TipFrames:
        """Return the fingertip frames for joint angles (K, n) or (n,) [rad]."""
        return self.skin.frames(self.angles(q_rad))

    def indenter_frames(self, q_rad: ArrayLike) -> TipFrames:
        """Return the frames at the sphere's centre for joint angles (K, n) or (n,) [rad]."""
        return self.indenter.frames(self.angles(q_rad))

    def frames(self, q_rad: ArrayLike) -> tuple[TipFrames, TipFrames]:
        """Return the frames of the fingertip and at the sphere's centre for joint angles (K, n) or (n,) [rad]."""
        return self._pair.frames(self.angles(q_rad))

    def link_angles(self, q_rad: ArrayLike, tau_nm: ArrayLike) -> FloatArray:
        """Return the link angles (K, n) [rad]: measured angles (K, n) less the give of the drives at torques (K, n)."""
        q = self.angles(q_rad)
        give = self.description.compliance_rad_per_nm
        return q if give is None else q - give * self.angles(tau_nm)

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
        rows = np.atleast_2d(np.asarray(values, dtype=np.float64))
        count = len(self.description.joints)
        if rows.ndim != 2 or rows.shape[1] != count:
            raise ValueError(f"expected values of {count} joints; got shape {np.shape(values)}")
        return rows
