"""The guard's checks of every state.

The checks run in every period. A good state passes with a few array operations; only if one fails is the joint at
fault determined.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from skincal.dataset import SensorSpec
from skincal.dataset.columns import LARGEST
from skincal.errors import quoted, shown
from skincal.hand.clock import ClockCheck
from skincal.hand.driver import HandDriver, HandState
from skincal.hand.errors import HandError, HandErrorKind, is_number
from skincal.hand.guard_options import GuardOptions
from skincal.model.arrays import FloatArray
from skincal.robot.description import JOINT_FIELDS, NUMBERS, TAXEL_FIELDS, HandDescription

TEMPERATURES_C = (-273.15, 1000.0)
"""Lowest and highest temperature of a skin [deg C]; anything beyond is a fault of the sensor or its driver."""

ContactForce = Callable[[HandState], float]


class StateCheck:
    """Checker of states, one after the other.

    Args:
        contact_force: the contact force of a state [N]; None: not checked.
    """

    def __init__(
        self, driver: HandDriver, options: GuardOptions, contact_force: ContactForce | None = None
    ) -> None:
        description = driver.description
        self._description, self._options, self._contact_force = description, options, contact_force
        self._max_force_n = options.max_force_n or description.max_force_n
        self._joints_shape, self._taxels_shape = (len(description.joints),), (description.meta.sensor.taxels,)
        self._low, self._high = _bounds(description, options)
        self._values = np.empty_like(self._low)
        self._clock = ClockCheck(
            options,
            real_time=driver.real_time,
            period_s=driver.period_s,
            recorded=not driver.follows_commands,
        )
        # A recording need not hold raw counts.
        self._taxels = TaxelCheck(description.meta.sensor, options, raw=driver.follows_commands)

    def __call__(self, state: HandState, now_s: float, waited_s: float = 0.0) -> None:
        """Check a state.

        Args:
            state: state from the driver.
            now_s: our clock at its arrival [s].
            waited_s: time that the driver took for it [s].

        Raises:
            HandError: a violation; the guard stops the hand and says so.
        """
        self._form(state)
        self._joints(state)
        time_s = float(state.time_s)
        self._clock(time_s, now_s, waited_s)
        self._taxels(state.taxels, time_s - state.taxel_time_s, time_s)
        self._force(state)

    def _form(self, state: Any) -> None:
        """Check types and shapes."""
        if not isinstance(state, HandState):
            raise HandError(f"expected a HandState; got {shown(state)}", "state")
        for names, shape in ((_JOINT_FIELDS, self._joints_shape), (TAXEL_FIELDS, self._taxels_shape)):
            for name in names:
                value = getattr(state, name)
                if type(value) is not np.ndarray or value.shape != shape or value.dtype != np.float64:
                    text = f"state, {name}: expected an array of float64 of shape {shape}; got {shown(value)}"
                    raise HandError(text, "state")
        check_numbers(state, NUMBERS)
        low_c, high_c = TEMPERATURES_C
        if not (math.isnan(state.temperature_c) or low_c <= state.temperature_c <= high_c):
            expected = f"{low_c:g} to {high_c:g} degrees Celsius, or NaN if not measured"
            got = shown(state.temperature_c)
            raise HandError(f"state, temperature_c: expected {expected}; got {got}", "state")

    def _joints(self, state: HandState) -> None:
        """Check joint values against their limits; NaN fails every comparison, so non-finite values are found too."""
        values = self._values
        for row, field in enumerate(_JOINT_FIELDS):
            values[row] = getattr(state, field)
        inside = (values >= self._low) & (values <= self._high)
        if inside.all():
            return
        row, joint = (int(i) for i in np.argwhere(~inside)[0])
        name, value = self._description.joints[joint], float(values[row, joint])
        field, (kind, what, unit) = _JOINT_FIELDS[row], MEANINGS[row]
        if not math.isfinite(value):
            text = f"joint {name}: {what} ({field}) is {value}, which is not finite"
            raise HandError(text, "state", joint=name, value=value)
        above = value > self._high[row, joint]
        limit = float((self._high if above else self._low)[row, joint])
        side = "above" if above else "below"
        text = f"joint {name}: {what} is {value:.4g} {unit}, {side} the limit of {limit:.4g} {unit}"
        raise HandError(text, kind, joint=name, value=value, limit=limit)

    def _force(self, state: HandState) -> None:
        if self._contact_force is None:
            return
        try:
            force_n = float(self._contact_force(state))
        except Exception as error:
            raise HandError(f"the contact force cannot be computed: {quoted(error)}", "force") from error
        limit_n = self._max_force_n
        if not (math.isfinite(force_n) and abs(force_n) <= limit_n):
            text = f"contact force is {force_n:.3g} N, above the limit of {limit_n:.3g} N"
            raise HandError(text, "force", value=force_n, limit=limit_n)


def check_numbers(state: object, names: Iterable[str]) -> None:
    """Check that fields of a state are single numbers."""
    for name in names:
        value = getattr(state, name)
        if not is_number(value):
            raise HandError(f"state, {name}: expected a number; got {shown(value)}", "state")


class TaxelCheck:
    """Checker of taxel values, one image after the other; NaN is a taxel that does not respond.

    Args:
        raw: whether values are counts of the converter; else any number is a value.
    """

    def __init__(self, sensor: SensorSpec, options: GuardOptions, *, raw: bool = True) -> None:
        self._cols, self._options = sensor.cols, options
        low, high = (sensor.value_min, sensor.value_max) if raw else (None, None)
        self._low = -LARGEST if low is None else max(-LARGEST, low)
        self._high = LARGEST if high is None else min(LARGEST, high)
        self._whole = raw and sensor.integer
        self._answered_s = math.nan

    def __call__(self, values: FloatArray, age_s: FloatArray, time_s: float) -> None:
        """Check that existing values (J,) are finite, of the converter and fresh, and that some exist.

        Args:
            values: taxel values (J,).
            age_s: age of each value (J,) [s].
            time_s: the rig's clock [s].

        Raises:
            HandError: a violation.
        """
        if age_s.min() >= -self._options.taxel_ahead_s and age_s.max() <= self._options.taxel_age_s:
            # NaN fails the comparisons, and is treated below.
            good = (values >= self._low) & (values <= self._high) & np.isfinite(values)
            if good.all() and (not self._whole or (values == np.rint(values)).all()):
                self._answered_s = time_s
                return
        responding = np.flatnonzero(~np.isnan(values))
        for j in responding:
            self._check(f"taxel ({j // self._cols}, {j % self._cols})", float(values[j]), float(age_s[j]))
        if math.isnan(self._answered_s) or len(responding):
            self._answered_s = time_s
        silent_s, limit_s = time_s - self._answered_s, self._options.taxel_age_s
        if silent_s > limit_s:
            text = f"no taxel has responded for {silent_s:.3g} s, the limit is {limit_s:g} s"
            raise HandError(text, "taxels", value=silent_s, limit=limit_s)

    def _check(self, name: str, value: float, age_s: float) -> None:
        """Raise the violation of a taxel, if there is one."""
        low, high, options = self._low, self._high, self._options
        if not math.isfinite(value):
            raise HandError(f"{name} is {value}; expected counts, or NaN without a reading", "taxels")
        if not low <= value <= high:
            text = f"{name} is {value:.6g}; the converter gives {low:g} to {high:g} (value_min, value_max)"
            raise HandError(text, "taxels", value=value, limit=low if value < low else high)
        if self._whole and value != round(value):
            text = f"{name} is {value!r}; the converter gives whole numbers (integer = true)"
            raise HandError(text, "taxels", value=value)
        if math.isnan(age_s):
            raise HandError(f"{name} has a value, but its time stamp is NaN", "taxels")
        if age_s < -options.taxel_ahead_s:
            text = f"{name}: its time stamp lies {-age_s:.3g} s in the future of the hand's clock"
            raise HandError(text, "taxels", value=-age_s, limit=options.taxel_ahead_s)
        if age_s > options.taxel_age_s:
            text = f"{name} is stale: {age_s:.3g} s old, the limit is {options.taxel_age_s:g} s"
            raise HandError(text, "taxels", value=age_s, limit=options.taxel_age_s)


_JOINT_FIELDS = tuple(JOINT_FIELDS.values())
MEANINGS: tuple[tuple[HandErrorKind, str, str], ...] = (
    ("joint_limit", "measured angle", "rad"),
    ("velocity", "measured velocity", "rad/s"),
    ("torque", "measured torque", "N m"),
    ("joint_limit", "desired angle", "rad"),
)
"""Kind of error, name and unit of each of ``JOINT_FIELDS``."""


def _bounds(description: HandDescription, options: GuardOptions) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest allowed value of each of ``JOINT_FIELDS``, each (4, n)."""
    limits, margin = description.limits, options.joint_margin_rad
    lower, upper = limits.lower_rad - margin, limits.upper_rad + margin
    velocity = options.velocity_factor * limits.velocity_rad_per_s
    torque = options.torque_factor * limits.torque_nm
    return np.stack([lower, -velocity, -torque, lower]), np.stack([upper, velocity, torque, upper])
