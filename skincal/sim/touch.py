"""The true contact of the simulated hand."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skincal.model import Contacts
from skincal.model.arrays import FloatArray
from skincal.robot import HandDescription, Kinematics
from skincal.robot.contact import nearest_on_surface


@dataclass(frozen=True, eq=False)
class TrueContact:
    """True contact at one moment; positions and vectors are in the fingertip frame.

    Attributes:
        time_s: the hand's clock [s].
        point_m: (3,) the point of the surface nearest to the indenter [m].
        normal: (3,) unit normal there.
        force_n: normal force [N].
        shear_u_n: force on the skin towards growing beta [N].
        shear_v_n: force on the skin along +y [N].
        gap_m: distance of sphere and surface at rest; negative where it penetrates [m].
        q_rad: (n,) true angles of the links [rad].
    """

    time_s: float
    point_m: FloatArray
    normal: FloatArray
    force_n: float
    shear_u_n: float
    shear_v_n: float
    gap_m: float
    q_rad: FloatArray

    @property
    def touching(self) -> bool:
        """True if there is a force."""
        return self.force_n > 0

    def contacts(self) -> Contacts:
        """Return the contact in the form of the skin model."""
        return Contacts(self.point_m[None], self.normal[None], np.array([self.force_n]))


def true_contact(
    kinematics: Kinematics, time_s: float, q_rad: FloatArray, force_root_n: FloatArray
) -> TrueContact:
    """Return the contact at true angles of the links.

    Args:
        kinematics: the hand.
        time_s: its clock [s].
        q_rad: (n,) true angles [rad].
        force_root_n: (3,) force on the skin, root frame [N].
    """
    skin, indenter = kinematics.frames(q_rad)
    meta = kinematics.description.meta
    point, normal, height = nearest_on_surface(meta.surface.radius_m, skin.to_tip(indenter.origins_m))
    force = force_root_n @ skin.rotations[0]
    across = np.array([normal[0, 2], 0.0, -normal[0, 0]])
    assert meta.indenter.radius_m is not None
    return TrueContact(
        time_s=time_s,
        point_m=point[0],
        normal=normal[0],
        force_n=max(0.0, -float(force @ normal[0])),
        shear_u_n=float(force @ across),
        shear_v_n=float(force[1]),
        gap_m=float(height[0]) - meta.indenter.radius_m,
        q_rad=q_rad,
    )


def contact_stiffness(description: HandDescription, elasticity_pa_per_m: float, force_n: float) -> float:
    """Return the force over depth of a sphere in the skin at some force [N/m].

    For depths that are small compared with the radii the skin model gives F = pi E sqrt(R1 R2) d², with R1 and R2 the
    radii of the gap along and across: 1/R1 = 1/r, 1/R2 = 1/r + 1/R.
    """
    radius, round_m = description.meta.indenter.radius_m, description.meta.surface.radius_m
    assert radius is not None
    across = radius if round_m is None else 1 / (1 / radius + 1 / round_m)
    return math.sqrt(math.pi * elasticity_pa_per_m * math.sqrt(radius * across) * force_n)
