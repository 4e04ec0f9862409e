"""The description of a hand (``hand.toml`` and a URDF next to it), and its state as its sensors read it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from skincal.dataset import DatasetMeta
from skincal.errors import InputError, Problem
from skincal.model.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits that no command may exceed; each (n,), in the order of the joints.

    Attributes:
        velocity_rad_per_s: largest speed of a commanded angle [rad/s].
        torque_nm: largest torque [N m], of either sign.
    """

    lower_rad: FloatArray
    upper_rad: FloatArray
    velocity_rad_per_s: FloatArray
    torque_nm: FloatArray


@dataclass(frozen=True, eq=False)
class ImpedanceGains:
    """The joint impedance controller, each (n,): tau = K_p (q_d - q) - K_d dq, q_d low-passed.

    Attributes:
        stiffness_nm_per_rad: K_p [N m/rad].
        damping_nms_per_rad: K_d [N m s/rad].
        low_pass_hz: corner frequency of the first-order low-pass on commanded angles [Hz].
    """

    stiffness_nm_per_rad: FloatArray
    damping_nms_per_rad: FloatArray
    low_pass_hz: float


@dataclass(frozen=True)
class FingerDescription:
    """One finger: which joints move it, and the link whose frame matters.

    Attributes:
        joints: names of its joints, from the base to the tip.
        tip_link: the URDF link with the tip's frame: for the finger that carries the skin, the fingertip frame of the
            datasets (origin on the axis of the cylindrical part at its base, +y to the tip, +z out of the surface
            where beta = 0); for the finger with the indenter, a frame with its origin at the sphere's centre.
    """

    name: str
    joints: tuple[str, ...]
    tip_link: str


@dataclass(frozen=True, eq=False)
class HandDescription:
    """A hand that can calibrate its own skin.

    Attributes:
        name: name of the hand.
        urdf: the URDF file, an absolute path.
        joints: names of all driven joints, in the order in which states and commands carry them.
        limits: limits of the joints.
        gains: the joint impedance controller.
        skin_finger: the finger that carries the skin.
        indenter_finger: the finger with the cap and the indenter.
        home_rad: angles at which nothing touches, from which a session starts and to which it returns (n,) [rad].
        max_force_n: contact force that must never be exceeded [N].
        meta: metadata of this hand's datasets: sensor, surface, indenter, mount, position and clock.
        digest: SHA-256 of ``hand.toml`` and the URDF, so that a session resumes only with the same hand.
        compliance_rad_per_nm: compliance of the drives between angle sensor and link (n,) [rad/(N m)]: a
            link lags behind its measured angle by this times the torque. None: angles are measured at the links.
    """

    name: str
    urdf: Path
    joints: tuple[str, ...]
    limits: JointLimits
    gains: ImpedanceGains
    skin_finger: FingerDescription
    indenter_finger: FingerDescription
    home_rad: FloatArray
    max_force_n: float
    meta: DatasetMeta
    digest: str
    compliance_rad_per_nm: FloatArray | None = None

    @property
    def indenter_radius_m(self) -> float:
        """Radius of the indenter's sphere [m]."""
        radius_m = self.meta.indenter.radius_m
        assert radius_m is not None
        return radius_m


def values_of(description: Any, name: str = "") -> dict[str, str]:
    """Return all that a description of a hand or stage says, as texts by the names of its fields.

    The place of the URDF is left out; its content is in the digest.
    """
    if not is_dataclass(description):
        # Texts of arrays would be rounded.
        return {name: repr(description.tolist() if isinstance(description, np.ndarray) else description)}
    values: dict[str, str] = {}
    for one in fields(description):
        if one.name != "urdf":
            values |= values_of(getattr(description, one.name), f"{name}.{one.name}".lstrip("."))
    return values


JOINT_FIELDS: Final = {"q": "q_rad", "dq": "dq_rad_per_s", "tau": "tau_nm", "q_desired": "q_desired_rad"}
"""Arrays (n,) of a state, by the columns that tables have for them: ``q_0`` is that of joint 0."""
TAXEL_FIELDS: Final = ("taxels", "taxel_time_s")
ARRAYS: Final = (*JOINT_FIELDS.values(), *TAXEL_FIELDS)
"""Every array of a state, for all that check, send or store one."""
NUMBERS: Final = ("time_s", "temperature_c")
"""Every number of a state."""


@dataclass(frozen=True, eq=False)
class HandState:
    """State of a hand at one moment.

    Attributes:
        time_s: clock of the joints [s]; it never goes back. A simulated hand has its own clock, which may run
            faster than ours.
        q_rad: measured joint angles (n,) [rad], in the order of the description's joints.
        dq_rad_per_s: joint velocities (n,) [rad/s].
        tau_nm: measured joint torques (n,) [N m]: positive accelerates the joint towards growing angles.
        q_desired_rad: present target angles of the hand's controller (n,) [rad].
        taxels: taxel values (rows * cols,) [counts], flat index r * cols + c; NaN for a taxel that does not respond.
        taxel_time_s: time at which each taxel was read (rows * cols,) [s], on the clock of `time_s`.
        temperature_c: temperature of the skin, not of motors [deg C]; NaN if not measured.
    """

    time_s: float
    q_rad: FloatArray
    dq_rad_per_s: FloatArray
    tau_nm: FloatArray
    q_desired_rad: FloatArray
    taxels: FloatArray
    taxel_time_s: FloatArray
    temperature_c: float = float("nan")


def joint_columns(states: Sequence[HandState], names: Sequence[str]) -> dict[str, FloatArray]:
    """Return some of the joints' columns of states, each (T,), joint by joint; ``names`` are of ``JOINT_FIELDS``."""
    tables = {name: np.array([getattr(state, JOINT_FIELDS[name]) for state in states]) for name in names}
    return {f"{name}_{j}": column for name, table in tables.items() for j, column in enumerate(table.T)}


MOST_TURN_DEG = 360.0
MOST_VELOCITY_DEG_PER_S = 720.0
MOST_TORQUE_NM = 10.0
MOST_FORCE_N = 50.0
"""Largest limits that are accepted by default. Twice the speed of the DLR-Hand II (360 deg/s; its torque is
1.8 N m, the force of its fingertips 30 N), and more than any finger of this size gives or any skin bears."""

MOST_STIFFNESS_NM_PER_RAD = 1000.0
MOST_DAMPING_NMS_PER_RAD = 100.0
MOST_COMPLIANCE_RAD_PER_NM = 1.0
"""Largest gains, each more than twenty times that of the DLR-Hand II (5 N m/rad, 0.3 N m s/rad, 0.04 rad/(N m)); they
decide where the simulation, the contact force and a hand-over take the fingers to be."""

FIX = "Correct it; if the hand really bears that, allow it with --beyond-limits."


def check_limits(description: HandDescription, *, beyond: bool = False) -> None:
    """Refuse limits and gains that no finger has.

    Raises:
        InputError: some limits or gains are above their bounds; all are reported.
    """
    limits, gains, give = description.limits, description.gains, description.compliance_rad_per_nm
    give = np.zeros(1) if give is None else give
    turn = np.maximum(np.abs(limits.lower_rad), np.abs(limits.upper_rad))
    rows = (
        ("lower_deg, upper_deg", np.degrees(turn), MOST_TURN_DEG, "deg"),
        ("velocity_deg_per_s", np.degrees(limits.velocity_rad_per_s), MOST_VELOCITY_DEG_PER_S, "deg/s"),
        ("torque_nm", limits.torque_nm, MOST_TORQUE_NM, "N m"),
        ("stiffness_nm_per_rad", gains.stiffness_nm_per_rad, MOST_STIFFNESS_NM_PER_RAD, "N m/rad"),
        ("damping_nms_per_rad", gains.damping_nms_per_rad, MOST_DAMPING_NMS_PER_RAD, "N m s/rad"),
        ("compliance_rad_per_nm", give, MOST_COMPLIANCE_RAD_PER_NM, "rad/(N m)"),
        ("max_force_n", np.array([description.max_force_n]), MOST_FORCE_N, "N"),
    )
    problems: list[Problem] = []
    for name, values, bound, unit in rows if not beyond else ():
        # Allow for rounding of degrees; a NaN sets no limit at all.
        if not (values <= bound * (1 + 1e-9)).all():
            worst = int(np.argmax(np.where(np.isnan(values), math.inf, values)))
            joint = "" if name == "max_force_n" else f" of {description.joints[worst]}"
            place = f'limits of the hand "{description.name}", {name}{joint}'
            problems.append(Problem(place, f"at most {bound:g} {unit}", f"{values[worst]:.6g} {unit}", FIX))
    if problems:
        raise InputError(problems)
