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
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class DriveParameters:
    """Parameters of the drives, each (n,).

    Attributes:
        stiffness_nm_per_rad: K_p [N m/rad].
        damping_nms_per_rad: K_d [N m s/rad].
        low_pass_hz: corner frequency of the filter on commanded angles [Hz].
        drive_stiffness_nm_per_rad: K_e [N m/rad].
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
    """All drives of a hand: a compiled step, as six joints are too few for numpy.

    Attributes:
        filtered_rad: (n,) commanded angles after the low-pass [rad].
        motor_rad: (n,) angles of the motors [rad].
        speed_rad_per_s: (n,) speeds of the motors [rad/s].
        torque_nm: (n,) torques on the links [N m].
    """

    def __init__(self, parameters: DriveParameters, q_rad: ArrayLike, step_s: float) -> None:
        stiff, damp = parameters.stiffness_nm_per_rad, parameters.damping_nms_per_rad
        elastic, count = parameters.drive_stiffness_nm_per_rad, np.size(q_rad)
        # The motor's speed is solved implicitly, so that any step is stable.
        slow = damp + step_s * (stiff + elastic)
        columns = (stiff, elastic, parameters.friction_nm, parameters.torque_limit_nm, 1 / slow)
        share = -math.expm1(-2 * math.pi * parameters.low_pass_hz * step_s)
        self._constants = np.array([np.broadcast_to(v, count) for v in columns], dtype=np.float64)
        self._numbers = (share, float(step_s), float(parameters.link_damping_nms_per_rad))
        self._state = np.zeros((5, count))
        self._target, self.filtered_rad, self.motor_rad, self.speed_rad_per_s, self.torque_nm = self._state
        self._state[:3] = q_rad
        self._step = _compiled()
        # Compiled here, not in the first step: a guard gives the calls of a connected hand little time.
        at_rest = (0.0,) * count
        self._step(self._constants, self._numbers, self._state.copy(), at_rest, at_rest)

    @property
    def target_rad(self) -> FloatArray:
        """(n,) commanded angles [rad]; assigning to it sets them."""
        return self._target

    @target_rad.setter
    def target_rad(self, q_rad: ArrayLike) -> None:
        self._target[:] = q_rad

    def hold(self) -> None:
        """Hold the motors' present angles: the exerted torques fade, and no new ones arise."""
        self._state[:2] = self.motor_rad

    def step(self, q_rad: Sequence[float], dq_rad_per_s: Sequence[float]) -> list[float]:
        """Advance by one step; return the torques on the links [N m]."""
        self._step(self._constants, self._numbers, self._state, tuple(q_rad), tuple(dq_rad_per_s))
        return self.torque_nm.tolist()


def _advance(
    constants: FloatArray,
    numbers: tuple[float, float, float],
    state: FloatArray,
    q_rad: tuple[float, ...],
    dq_rad_per_s: tuple[float, ...],
) -> None:
    share, dt, damping = numbers
    for j in range(len(q_rad)):
        stiff, elastic, friction = constants[0, j], constants[1, j], constants[2, j]
        limit, per_nm = constants[3, j], constants[4, j]
        smooth = state[1, j] + share * (state[0, j] - state[1, j])
        angle = state[2, j]
        wanted = min(max(stiff * (smooth - angle), -limit), limit)
        net = wanted - elastic * (angle - q_rad[j])
        rate = 0.0
        if net > friction:
            rate = (net - friction) * per_nm
        elif net < -friction:
            rate = (net + friction) * per_nm
        angle += dt * rate
        state[1, j], state[2, j], state[3, j] = smooth, angle, rate
        state[4, j] = elastic * (angle - q_rad[j]) + damping * (rate - dq_rad_per_s[j])


@cache
def _compiled() -> Any:
    """Compile the step, or load it; numba is imported with the first drives."""
    from skincal.model.press.jit import cached

    return cached(_advance, "drives", {"nogil": True, "error_model": "numpy"})
