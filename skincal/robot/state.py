"""The state of a hand, real or simulated, as its sensors read it."""

from __future__ import annotations

from dataclasses import dataclass

from skincal.model.arrays import FloatArray


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
