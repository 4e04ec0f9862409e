"""The guard of a stage: it checks every state and every command, and stops the stage on any fault."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from skincal.errors import InputError, Problem, shown
from skincal.hand.checks import ClockCheck, StepCheck, TaxelCheck, check_numbers
from skincal.hand.driver import FloatArray, StageDescription, StageDriver, StageState
from skincal.hand.errors import HandError
from skincal.hand.guard_calls import Guarded
from skincal.hand.guard_options import GuardOptions

ROUNDING_M = 1e-9
"""Tolerance of a command's limits, for rounding [m]."""

BEYOND_M = 0.5e-3
"""Tolerance of a measured position beyond the travel, for overshoot, and of a step between two states [m]."""

MOST_TRAVEL_M, MOST_SPEED_M_PER_S, MOST_FORCE_N = 1.0, 0.5, 200.0
"""Largest limits that are accepted by default: more travel than a bench has room for, twice the speed of an arm that
moves next to a person (0.25 m/s, ISO 10218-1), and ten times the force that a skin is pressed with."""


class GuardedStage(Guarded[StageDescription, StageState, FloatArray]):
    """A stage that is safe to move; arguments are those of :class:`~skincal.hand.guard_calls.Guarded`."""

    rig, advice = "stage", {}

    def _check_limits(self) -> None:
        check_stage(self.description, beyond=self._options.beyond_limits)

    def _checks(self) -> tuple[StageStateCheck, StageCommandCheck]:
        return StageStateCheck(self._made, self._options), StageCommandCheck(self._made)


def check_stage(rig: StageDescription, *, beyond: bool = False) -> None:
    """Refuse limits that are invalid, or beyond those of any bench.

    Args:
        rig: the stage.
        beyond: whether any limit is allowed, as somebody has said so.

    Raises:
        InputError: travel, speed or force are no numbers above zero, or above their bounds.
    """
    most = (MOST_TRAVEL_M, MOST_SPEED_M_PER_S, MOST_FORCE_N) if not beyond else (math.inf,) * 3
    rows = (
        ("travel (upper_m - lower_m)", np.subtract(rig.upper_m, rig.lower_m), most[0], "m"),
        ("max_speed_m_per_s", np.array([rig.max_speed_m_per_s]), most[1], "m/s"),
        ("max_force_n", np.array([rig.max_force_n]), most[2], "N"),
    )
    fix = "Correct it; if the stage really bears that, allow it with --beyond-limits."
    problems = [
        Problem(f"stage {rig.name}, {name}", f"above 0 {unit}, at most {bound:g} {unit}", f"{values}", fix)
        for name, values, bound, unit in rows
        if not ((values > 0) & np.isfinite(values) & (values <= bound)).all()
    ]
    if problems:
        raise InputError(problems)


class StageStateCheck:
    """Checker of states, one after the other."""

    def __init__(self, driver: StageDriver, options: GuardOptions) -> None:
        self._rig, self._options = driver.description, options
        self._limit_n = options.max_force_n or self._rig.max_force_n
        self._clock = ClockCheck(options, real_time=driver.real_time, period_s=driver.period_s)
        self._taxels = TaxelCheck(self._rig.meta.sensor, options)
        self._last_s, self._last_m = -math.inf, np.full(3, math.nan)

    def __call__(self, state: StageState, now_s: float, waited_s: float = 0.0) -> None:
        """Check a state; arguments and errors are those of a hand's state."""
        self._form(state)
        last_s, self._last_s = self._last_s, float(state.time_s)
        if not self._last_s > last_s:
            raise HandError(f"expected a time after {last_s:.6g} s; got {self._last_s:.6g} s", "clock")
        self._clock(self._last_s, now_s, waited_s)
        self._taxels(state.taxels, np.zeros(len(state.taxels)), self._last_s)
        self._limits(state)
        self._speed(state, self._last_s - last_s)

    def _form(self, state: object) -> None:
        if not isinstance(state, StageState):
            raise HandError(f"expected a StageState; got {shown(state)}", "state")
        sensor = self._rig.meta.sensor
        for name, shape in (("position_m", (3,)), ("taxels", (sensor.taxels,))):
            value = getattr(state, name)
            if type(value) is not np.ndarray or value.shape != shape or not _plain(value.dtype):
                text = f"state, {name}: expected an array of numbers of shape {shape}; got {shown(value)}"
                raise HandError(text, "taxels" if name == "taxels" else "state")
        check_numbers(state, ("time_s", "force_n"))
        if not np.isfinite([*state.position_m, state.force_n, state.time_s]).all():
            raise HandError(f"expected a finite time, place and force; got {state}", "state")

    def _speed(self, state: StageState, passed_s: float) -> None:
        """Check how far the tip has moved since the last state; it may be pushed, or lose its place."""
        last_m, self._last_m = self._last_m, np.array(state.position_m, dtype=np.float64)
        moved_m = float(np.linalg.norm(self._last_m - last_m))  # NaN at first
        most_m = self._options.velocity_factor * self._rig.max_speed_m_per_s * passed_s + BEYOND_M
        if moved_m > most_m:
            moved = f"the tip moved by {1e3 * moved_m:.3g} mm in {1e3 * passed_s:.3g} ms"
            text = f"{moved}, {1e3 * most_m:.3g} mm is the most"
            raise HandError(text, "velocity", value=moved_m, limit=most_m)

    def _limits(self, state: StageState) -> None:
        force_n, place = float(state.force_n), state.position_m
        if abs(force_n) > self._limit_n:
            text = f"the force is {force_n:.3g} N, above the limit of {self._limit_n:.3g} N"
            raise HandError(text, "force", value=force_n, limit=self._limit_n)
        if (place < self._rig.lower_m - BEYOND_M).any() or (place > self._rig.upper_m + BEYOND_M).any():
            raise HandError(f"the tip is at {_shown(place)}, outside its travel", "joint_limit")


class StageCommandCheck(StepCheck[StageState, FloatArray]):
    """Checker of the commands of a stage."""

    def __init__(self, driver: StageDriver) -> None:
        super().__init__(driver, [f"axis {name}" for name in "xyz"], BEYOND_M, np.zeros(3), "m")
        self._rig = driver.description

    def _read(self, state: StageState) -> tuple[FloatArray, FloatArray, FloatArray]:
        place = np.array(state.position_m, dtype=np.float64)
        return place, np.zeros(3), np.stack((place, np.full(3, state.force_n)))

    def __call__(self, command: FloatArray, now_s: float) -> None:
        """See :meth:`StepCheck.__call__`."""
        base = self._before()
        if (
            not isinstance(command, np.ndarray)  # pyright: ignore[reportUnnecessaryIsInstance]
            or command.shape != (3,)
            or command.dtype != np.float64
            or not np.isfinite(command).all()
        ):
            raise HandError(f"expected a place (3,) of finite numbers; got {shown(command)}", "command")
        rig = self._rig
        if (command < rig.lower_m - ROUNDING_M).any() or (command > rig.upper_m + ROUNDING_M).any():
            raise HandError(f"{_shown(command)} lies outside the travel", "command")
        self._check_frozen()
        step_m, longest_m = float(np.linalg.norm(command - base)), self._longest_m(now_s)
        if step_m > longest_m + ROUNDING_M:
            text = f"a step of {1e3 * step_m:.3g} mm, and in the time passed {1e3 * longest_m:.3g} mm is the most"
            raise HandError(text, "command", value=step_m, limit=longest_m)

    def nearest(self, target: FloatArray, now_s: float) -> FloatArray:
        """Return the allowed position (3,) [m] nearest to a position."""
        base, rig = self._before(), self._rig
        inside = np.clip(target, rig.lower_m, rig.upper_m)
        step_m, longest_m = float(np.linalg.norm(inside - base)), self._longest_m(now_s)
        return inside if step_m <= longest_m else base + (inside - base) * (longest_m / step_m)

    def _longest_m(self, now_s: float) -> float:
        return self._rig.max_speed_m_per_s * self._passed_s(now_s)


def _plain(kind: np.dtype[Any]) -> bool:
    return kind.kind in "iu" or kind.type in (np.float32, np.float64)


def _shown(place: FloatArray) -> str:
    return "(" + ", ".join(f"{1e3 * x:.3g}" for x in place) + ") mm"
