"""The description of a hand (``hand.toml`` and a URDF next to it), and its state as its sensors read it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from skincal.dataset import DatasetMeta
from skincal.model.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits that no command may exceed; each (n,), in the order of the joints.

    Attributes:
        lower_rad: smallest angle [rad].
        upper_rad: largest angle [rad].
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
        name: name of the finger.
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
        temperature_c: temperature at the skin [deg C]; NaN if not measured.
    """

    time_s: float
    q_rad: FloatArray
    dq_rad_per_s: FloatArray
    tau_nm: FloatArray
    q_desired_rad: FloatArray
    taxels: FloatArray
    taxel_time_s: FloatArray
    temperature_c: float = float("nan")
