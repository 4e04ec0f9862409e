"""The drives: impedance controller, stick friction and parasitic stiffness between motor and link.

Per joint, with commanded angle q_d, motor angle m and link angle q:

    low-pass       q_f' = 2 pi f (q_d - q_f)
    controller     tau_m = K_p (q_f - m) - K_d m'          (the first part within the torque limit)
    motor          tau_m = K_e (m - q) + friction          (a motor without inertia)
    link           tau   = K_e (m - q) + d (m' - q')

Friction holds the motor while the remaining torque stays within the stick friction; when the motor moves, friction has
that size, against the motion. At rest and without friction a deflection q_d - q thus meets K_p and K_e in series.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DriveParameters:
    """Parameters of the drives, each (n,).

    Attributes:
        stiffness_nm_per_rad: K_p [N m/rad].
        damping_nms_per_rad: K_d [N m s/rad].
        low_pass_hz: corner frequency of the filter on commanded angles [Hz].
        drive_stiffness_nm_per_rad: K_e [N m/rad].
        friction_nm: stick friction [N m].
        torque_limit_nm: largest torque of the controller [N m].
        link_damping_nms_per_rad: d, damping in the drive's elasticity [N m s/rad].
    """

    stiffness_nm_per_rad: FloatArray
    damping_nms_per_rad: FloatArray
    low_pass_hz: float
    drive_stiffness_nm_per_rad: FloatArray
    friction_nm: FloatArray
    torque_limit_nm: FloatArray
    link_damping_nms_per_rad: float


class Drives:
    """All drives of a hand, computed with plain numbers: for six joints numpy would be slower.

    Args:
        parameters: parameters of the drives.
        q_rad: initial angles of the links, at rest [rad].
        step_s: time step [s].
    """

    def __init__(self, parameters: DriveParameters, q_rad: Sequence[float], step_s: float) -> None:
        stiff, damp = parameters.stiffness_nm_per_rad, parameters.damping_nms_per_rad
        elastic, count = parameters.drive_stiffness_nm_per_rad, len(q_rad)
        self._share = -math.expm1(-2 * math.pi * parameters.low_pass_hz * step_s)
        self._damping = parameters.link_damping_nms_per_rad
        self._step = step_s
        # The motor's speed is solved implicitly, so that any step is stable.
        slow = damp + step_s * (stiff + elastic)
        columns = (stiff, elastic, parameters.friction_nm, parameters.torque_limit_nm, 1 / slow)
        table: list[list[float]] = np.column_stack([np.broadcast_to(v, count) for v in columns]).tolist()
        self._constants = [(j, *_five(row)) for j, row in enumerate(table)]
        self.target_rad = [float(q) for q in q_rad]
        self.filtered_rad = list(self.target_rad)
        self.motor_rad = list(self.target_rad)
        self.speed_rad_per_s = [0.0] * count
        self.torque_nm = [0.0] * count

    def hold(self) -> None:
        """Hold the motors' present angles: the exerted torques fade, and no new ones arise."""
        self.target_rad = list(self.motor_rad)
        self.filtered_rad = list(self.motor_rad)

    def step(self, q_rad: Sequence[float], dq_rad_per_s: Sequence[float]) -> list[float]:
        """Advance by one step.

        Args:
            q_rad: angles of the links [rad].
            dq_rad_per_s: their velocities [rad/s].

        Returns:
            Torques on the links [N m].
        """
        share, dt, damping = self._share, self._step, self._damping
        target, filtered, motor = self.target_rad, self.filtered_rad, self.motor_rad
        speed, torque = self.speed_rad_per_s, self.torque_nm
        for j, stiff, elastic, friction, limit, per_nm in self._constants:
            smooth = filtered[j]
            smooth += share * (target[j] - smooth)
            filtered[j] = smooth
            angle = motor[j]
            wanted = stiff * (smooth - angle)
            if wanted > limit:
                wanted = limit
            elif wanted < -limit:
                wanted = -limit
            net = wanted - elastic * (angle - q_rad[j])
            if net > friction:
                rate = (net - friction) * per_nm
            elif net < -friction:
                rate = (net + friction) * per_nm
            else:
                rate = 0.0
            angle += dt * rate
            motor[j] = angle
            speed[j] = rate
            torque[j] = elastic * (angle - q_rad[j]) + damping * (rate - dq_rad_per_s[j])
        return torque


def _five(row: list[float]) -> tuple[float, float, float, float, float]:
    return row[0], row[1], row[2], row[3], row[4]
