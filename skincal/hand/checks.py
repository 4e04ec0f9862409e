"""What the guard looks at: every state that comes, and every command before it goes.

The checks run in every period. A good state passes with a handful of array operations; only when one fails is it
found out which joint it was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from skincal.hand.driver import HandCommand, HandState
from skincal.hand.errors import HandErrorKind
from skincal.hand.options import GuardOptions
from skincal.robot.description import HandDescription

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Violation:
    """One thing that may not be, as :class:`~skincal.hand.errors.HandError` tells it."""

    kind: HandErrorKind
    text: str
    joint: str | None = None
    value: float | None = None
    limit: float | None = None


class StateCheck:
    """Checks states, one after the other.

    Args:
        description: the hand.
        options: limits and times.
    """

    def __init__(self, description: HandDescription, options: GuardOptions) -> None:
        self._description = description
        self._options = options
        joints, taxels = len(description.joints), description.meta.sensor.taxels
        self._joints_shape, self._taxels_shape = (joints,), (taxels,)
        self._low, self._high = _bounds(description, options)
        self._values = np.empty_like(self._low)
        self._last_s = -math.inf
        self._advanced_s = math.nan
        self._least_lag_s = math.inf
        self._answered_s = math.nan

    def __call__(self, state: HandState, now_s: float) -> Violation | None:
        """What is wrong with a state that came at ``now_s`` on our clock [s]; None: nothing."""
        return self._form(state) or self._joints(state) or self._clock(state, now_s) or self._taxels(state)

    def _form(self, state: Any) -> Violation | None:
        """Types and shapes."""
        if not isinstance(state, HandState):
            return Violation("state", f"expected a HandState; got {_shown(state)}")
        for names, shape in ((JOINT_FIELDS, self._joints_shape), (TAXEL_FIELDS, self._taxels_shape)):
            for name in names:
                value = getattr(state, name)
                if type(value) is not np.ndarray or value.shape != shape or value.dtype != np.float64:
                    text = (
                        f"state, {name}: expected an array of float64 of shape {shape}; got {_shown(value)}"
                    )
                    return Violation("state", text)
        for name in ("time_s", "temperature_c"):
            value = getattr(state, name)
            if not isinstance(value, float | int | np.floating) or isinstance(value, bool):
                return Violation("state", f"state, {name}: expected a number; got {_shown(value)}")
        return None

    def _joints(self, state: HandState) -> Violation | None:
        """NaN fails every comparison, so that one of them finds what is not finite as well."""
        values = self._values
        values[0], values[1] = state.q_rad, state.dq_rad_per_s
        values[2], values[3] = state.tau_nm, state.q_desired_rad
        inside = (values >= self._low) & (values <= self._high)
        if inside.all():
            return None
        row, joint = (int(i) for i in np.argwhere(~inside)[0])
        name, value = self._description.joints[joint], float(values[row, joint])
        field, (kind, what, unit) = JOINT_FIELDS[row], MEANINGS[row]
        if not math.isfinite(value):
            text = f"joint {name}: {what} ({field}) is {value}, no finite number"
            return Violation("state", text, joint=name, value=value)
        above = value > self._high[row, joint]
        limit = float((self._high if above else self._low)[row, joint])
        side = "above" if above else "below"
        text = f"joint {name}: {what} is {value:.4g} {unit}, {side} the limit of {limit:.4g} {unit}"
        return Violation(kind, text, joint=name, value=value, limit=limit)

    def _clock(self, state: HandState, now_s: float) -> Violation | None:
        time_s, last_s = float(state.time_s), self._last_s
        if not math.isfinite(time_s):
            return Violation("clock", f"the hand's clock says {time_s}, no finite number", value=time_s)
        if time_s < last_s:
            text = f"the hand's clock went back, from {last_s:.6f} s to {time_s:.6f} s"
            return Violation("clock", text, value=time_s, limit=last_s)
        if time_s > last_s:
            self._last_s, self._advanced_s = time_s, now_s
        elif now_s - self._advanced_s > self._options.stale_s:
            for_s, limit_s = now_s - self._advanced_s, self._options.stale_s
            text = (
                f"the hand's clock has stood at {time_s:.6f} s for {for_s:.3g} s, the limit is {limit_s:g} s: "
                "the states are stale"
            )
            return Violation("clock", text, value=for_s, limit=limit_s)
        if self._options.lag_s is None:
            return None
        lag_s = now_s - time_s
        self._least_lag_s = min(self._least_lag_s, lag_s)
        behind_s = lag_s - self._least_lag_s
        if behind_s > self._options.lag_s:
            text = f"the states come {behind_s:.3g} s late, the limit is {self._options.lag_s:g} s: they are stale"
            return Violation("clock", text, value=behind_s, limit=self._options.lag_s)
        return None

    def _taxels(self, state: HandState) -> Violation | None:
        """Values that are there must be finite and fresh; NaN is a taxel that does not answer."""
        time_s, options = float(state.time_s), self._options
        age_s = time_s - state.taxel_time_s
        if age_s.min() >= -options.taxel_ahead_s and age_s.max() <= options.taxel_age_s:
            values = state.taxels
            if np.isfinite(values).all():
                self._answered_s = time_s
                return None
        return self._odd_taxels(state, age_s)

    def _odd_taxels(self, state: HandState, age_s: FloatArray) -> Violation | None:
        """Some taxel does not answer, or is at fault: each by itself."""
        options, cols = self._options, self._description.meta.sensor.cols
        for j in np.flatnonzero(~np.isnan(state.taxels)):
            name = f"taxel ({j // cols}, {j % cols})"
            value, age = float(state.taxels[j]), float(age_s[j])
            if not math.isfinite(value):
                return Violation(
                    "taxels", f"{name} is {value}; expected counts, or NaN where it does not answer"
                )
            if math.isnan(age):
                return Violation("taxels", f"{name} has a value, but its time stamp is NaN")
            if age < -options.taxel_ahead_s:
                text = f"{name}: its time stamp lies {-age:.3g} s in the future of the hand's clock"
                return Violation("taxels", text, value=-age, limit=options.taxel_ahead_s)
            if age > options.taxel_age_s:
                text = f"{name} is stale: {age:.3g} s old, the limit is {options.taxel_age_s:g} s"
                return Violation("taxels", text, value=age, limit=options.taxel_age_s)
        time_s = float(state.time_s)
        if math.isnan(self._answered_s) or not np.isnan(state.taxels).all():
            self._answered_s = time_s
        if time_s - self._answered_s > options.taxel_age_s:
            silent_s = time_s - self._answered_s
            text = f"no taxel has answered for {silent_s:.3g} s, the limit is {options.taxel_age_s:g} s"
            return Violation("taxels", text, value=silent_s, limit=options.taxel_age_s)
        return None


class CommandCheck:
    """Checks commands: form, joint limits, and the step from what was commanded one period before.

    Args:
        description: the hand.
        period_s: time between two commands [s].
    """

    def __init__(self, description: HandDescription, period_s: float) -> None:
        limits = description.limits
        self._joints = description.joints
        self._low, self._high = limits.lower_rad - ROUNDING_RAD, limits.upper_rad + ROUNDING_RAD
        self._step = limits.velocity_rad_per_s * period_s
        self._limits, self._period_s = limits, period_s

    def __call__(self, command: HandCommand, before_rad: FloatArray) -> Violation | None:
        """What is wrong with a command after ``before_rad`` was commanded, (n,) [rad]; None: nothing."""
        if not isinstance(command, HandCommand):  # pyright: ignore[reportUnnecessaryIsInstance]
            return Violation("command", f"expected a HandCommand; got {_shown(command)}")
        q = command.q_desired_rad
        shape = self._step.shape
        if type(q) is not np.ndarray or q.shape != shape or q.dtype != np.float64:
            text = f"command, q_desired_rad: expected an array of float64 of shape {shape}; got {_shown(q)}"
            return Violation("command", text)
        if (
            (q >= self._low) & (q <= self._high) & (np.abs(q - before_rad) <= self._step + ROUNDING_RAD)
        ).all():
            return None
        return self._named(q, before_rad)

    def _named(self, q: FloatArray, before_rad: FloatArray) -> Violation | None:
        for j, name in enumerate(self._joints):
            value, step = float(q[j]), float(abs(q[j] - before_rad[j]))
            low, high = float(self._limits.lower_rad[j]), float(self._limits.upper_rad[j])
            if not math.isfinite(value):
                return Violation("command", f"joint {name}: commanded angle is {value}", name, value)
            if not self._low[j] <= value <= self._high[j]:
                text = f"joint {name}: commanded angle {value:.4g} rad lies outside its limits [{low:.4g}, {high:.4g}]"
                return Violation("command", text, name, value, low if value < low else high)
            if step > self._step[j] + ROUNDING_RAD:
                largest = float(self._step[j])
                speed = float(self._limits.velocity_rad_per_s[j])
                text = (
                    f"joint {name}: commanded angle steps by {step:.4g} rad; at {speed:.4g} rad/s and a period of "
                    f"{self._period_s:g} s at most {largest:.4g} rad are allowed"
                )
                return Violation("command", text, name, step, largest)
        return None

    def nearest(self, q_rad: FloatArray, before_rad: FloatArray) -> FloatArray:
        """The allowed angles (n,) [rad] that are nearest to ``q_rad``, joint by joint."""
        near = np.clip(q_rad, before_rad - self._step, before_rad + self._step)
        return np.clip(near, self._limits.lower_rad, self._limits.upper_rad)


JOINT_FIELDS = ("q_rad", "dq_rad_per_s", "tau_nm", "q_desired_rad")
TAXEL_FIELDS = ("taxels", "taxel_time_s")
MEANINGS: tuple[tuple[HandErrorKind, str, str], ...] = (
    ("joint_limit", "measured angle", "rad"),
    ("velocity", "measured velocity", "rad/s"),
    ("torque", "measured torque", "N m"),
    ("joint_limit", "desired angle", "rad"),
)
"""Kind of the error, name and unit of each of ``JOINT_FIELDS``."""

ROUNDING_RAD = 1e-9
"""What a command may pass a limit by, as sums of steps are not exact [rad]."""


def _bounds(description: HandDescription, options: GuardOptions) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest value of each of ``JOINT_FIELDS``, each (4, n)."""
    limits, margin = description.limits, options.joint_margin_rad
    lower, upper = limits.lower_rad - margin, limits.upper_rad + margin
    velocity = options.velocity_factor * limits.velocity_rad_per_s
    torque = options.torque_factor * limits.torque_nm
    return np.stack([lower, -velocity, -torque, lower]), np.stack([upper, velocity, torque, upper])


def _shown(value: Any) -> str:
    """A value of a wrong type or shape, briefly."""
    if isinstance(value, np.ndarray):
        array = cast(NDArray[Any], value)
        return f"an array of {array.dtype} of shape {array.shape}"
    return f"{type(value).__name__} {value!r:.60}"
