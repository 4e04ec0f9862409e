"""A bolt that is rolled along a sine; the policy has to infer its orientation from touch."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from skincal.envs.bodies import turn_of
from skincal.envs.drawing import Values
from skincal.envs.roll import RollEnv
from skincal.envs.task_options import TaskOptions
from skincal.envs.trajectories import BOLT_HZ, ORIENTATIONS_DEG, sine
from skincal.model.arrays import FloatArray
from skincal.tasks import SPEEDS_RAD_PER_S, Task


class BoltRollEnv(RollEnv):
    """``skincal/BoltRoll-v0``: see :class:`RollEnv`.

    The bolt is put between the fingers at one of four angles from the finger's across direction, its head in front. The
    policy observes the target distance along the bolt's normal, but not the normal: the axis of the bolt on the sensor
    after the grasp, rotated by 90°.
    """

    task = Task.bolt
    target_size = 1

    @classmethod
    def default_options(cls) -> TaskOptions:
        """Return options for a sine up to four times as fast as the marble's targets, with more solver iterations."""
        return TaskOptions(speed_rad_per_s=SPEEDS_RAD_PER_S[Task.bolt], solver_iterations=30)

    def _initial_rotation(self, values: Values) -> FloatArray:
        drawn = float(self.np_random.choice(ORIENTATIONS_DEG))
        given = self._episode.orientation_deg
        self._orientation_deg = drawn if given is None else given
        return turn_of("bolt", values, self._orientation_deg)

    def _plan_targets(self, steps: int) -> FloatArray:
        drawn = float(self.np_random.uniform(*BOLT_HZ))
        given = self._episode.frequency_hz
        self._frequency_hz = drawn if given is None else given
        return sine(steps, self._frequency_hz)

    def _look(self) -> None:
        super()._look()
        view, axis = self._view, 0.0  # angle of the bolt's axis from +u towards +v [rad]
        if view.sound:
            u, v = self.world.sensor.direction(view.tip.turned(view.body.rotation[:, 0]))
            axis = math.atan2(v, u)
        if self._step == 0:
            self._first_rad, self._start_m = axis, self._view.position_m
            # The direction (2,) in which it shall roll.
            self._normal = np.array([-math.sin(axis), math.cos(axis)])
        self._turned_rad = math.remainder(axis - self._first_rad, 2 * math.pi)

    def _target_m(self) -> FloatArray:
        return self._targets[self._step, 0] * self._normal

    def _angle_rad(self) -> float | None:
        return self._turned_rad

    def _orientation(self) -> FloatArray:
        first = self._first_rad
        return np.array([math.cos(first), math.sin(first), self._turned_rad, self._frequency_hz])

    def _info(self, terms: dict[str, float]) -> dict[str, Any]:
        own = {
            "orientation_deg": self._orientation_deg,
            "orientation_rad": self._first_rad,
            "orientation_error_rad": self._turned_rad,
            "frequency_hz": self._frequency_hz,
            "rolled_m": float((self._view.position_m - self._start_m) @ self._normal),
            "rolled_target_m": float(self._targets[self._step, 0]),
        }
        return super()._info(terms) | own
