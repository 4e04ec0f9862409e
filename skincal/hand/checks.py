"""The guard's checks of every state.

The checks run in every period. A good state passes with a few array operations; only if one fails is the joint at
fault determined.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from skincal.dataset.columns import LARGEST
from skincal.errors import quoted, shown
from skincal.hand.clock import ClockCheck
from skincal.hand.driver import HandDriver, HandState
from skincal.hand.errors import HandErrorKind, Violation, is_number
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
        joints, taxels = len(description.joints), description.meta.sensor.taxels
        self._joints_shape, self._taxels_shape = (joints,), (taxels,)
        self._low, self._high = _bounds(description, options)
        self._values = np.empty_like(self._low)
        self._clock = ClockCheck(
            options,
            real_time=driver.real_time,
            period_s=driver.period_s,
            recorded=not driver.follows_commands,
        )
        # A recording need not hold raw counts.
        sensor, raw = description.meta.sensor, driver.follows_commands
        self._counts = (
            max(-LARGEST, sensor.value_min) if raw and sensor.value_min is not None else -LARGEST,
            min(LARGEST, sensor.value_max) if raw and sensor.value_max is not None else LARGEST,
        )
        self._whole = raw and sensor.integer
        self._answered_s = math.nan

    def __call__(self, state: HandState, now_s: float, waited_s: float = 0.0) -> Violation | None:
        """Return the violation of a state; None if it is sound.

        Args:
            state: state from the driver.
            now_s: our clock at its arrival [s].
            waited_s: time that the driver took for it [s].
        """
        return (
            self._form(state)
            or self._joints(state)
            or self._clock(float(state.time_s), now_s, waited_s)
            or self._taxels(state)
            or self._force(state)
        )

    def _form(self, state: Any) -> Violation | None:
        """Check types and shapes."""
        if not isinstance(state, HandState):
            return Violation("state", f"expected a HandState; got {shown(state)}")
        for names, shape in ((_JOINT_FIELDS, self._joints_shape), (TAXEL_FIELDS, self._taxels_shape)):
            for name in names:
                value = getattr(state, name)
                if type(value) is not np.ndarray or value.shape != shape or value.dtype != np.float64:
                    text = f"state, {name}: expected an array of float64 of shape {shape}; got {shown(value)}"
                    return Violation("state", text)
        for name in NUMBERS:
            value = getattr(state, name)
            if not is_number(value):
                return Violation("state", f"state, {name}: expected a number; got {shown(value)}")
        low_c, high_c = TEMPERATURES_C
        if not (math.isnan(state.temperature_c) or low_c <= state.temperature_c <= high_c):
            expected = f"{low_c:g} to {high_c:g} degrees Celsius, or NaN if not measured"
            got = shown(state.temperature_c)
            return Violation("state", f"state, temperature_c: expected {expected}; got {got}")
        return None

    def _joints(self, state: HandState) -> Violation | None:
        """Check joint values against their limits; NaN fails every comparison, so non-finite values are found too."""
        values = self._values
        for row, field in enumerate(_JOINT_FIELDS):
            values[row] = getattr(state, field)
        inside = (values >= self._low) & (values <= self._high)
        if inside.all():
            return None
        row, joint = (int(i) for i in np.argwhere(~inside)[0])
        name, value = self._description.joints[joint], float(values[row, joint])
        field, (kind, what, unit) = _JOINT_FIELDS[row], MEANINGS[row]
        if not math.isfinite(value):
            text = f"joint {name}: {what} ({field}) is {value}, which is not finite"
            return Violation("state", text, joint=name, value=value)
        above = value > self._high[row, joint]
        limit = float((self._high if above else self._low)[row, joint])
        side = "above" if above else "below"
        text = f"joint {name}: {what} is {value:.4g} {unit}, {side} the limit of {limit:.4g} {unit}"
        return Violation(kind, text, joint=name, value=value, limit=limit)

    def _taxels(self, state: HandState) -> Violation | None:
        """Check that existing taxel values are finite and fresh; NaN is a taxel that does not respond."""
        time_s, options = float(state.time_s), self._options
        age_s = time_s - state.taxel_time_s
        if age_s.min() >= -options.taxel_ahead_s and age_s.max() <= options.taxel_age_s:
            low, high = self._counts
            values = state.taxels
            # NaN fails the comparisons, and is treated below.
            good = (values >= low) & (values <= high) & np.isfinite(values)
            if good.all() and (not self._whole or (values == np.rint(values)).all()):
                self._answered_s = time_s
                return None
        return self._odd_taxels(state, age_s)

    def _odd_taxels(self, state: HandState, age_s: FloatArray) -> Violation | None:
        """Return the violation of the first faulty taxel; None if missing taxels are the only fault."""
        options, cols = self._options, self._description.meta.sensor.cols
        for j in np.flatnonzero(~np.isnan(state.taxels)):
            name = f"taxel ({j // cols}, {j % cols})"
            value, age = float(state.taxels[j]), float(age_s[j])
            if not math.isfinite(value):
                return Violation("taxels", f"{name} is {value}; expected counts, or NaN without a reading")
            if not self._counts[0] <= value <= self._counts[1]:
                low, high = self._counts
                text = (
                    f"{name} is {value:.6g}; the converter gives {low:g} to {high:g} (value_min, value_max)"
                )
                return Violation("taxels", text, value=value, limit=low if value < low else high)
            if self._whole and value != round(value):
                text = f"{name} is {value!r}; the converter gives whole numbers (integer = true)"
                return Violation("taxels", text, value=value)
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
            text = f"no taxel has responded for {silent_s:.3g} s, the limit is {options.taxel_age_s:g} s"
            return Violation("taxels", text, value=silent_s, limit=options.taxel_age_s)
        return None

    def _force(self, state: HandState) -> Violation | None:
        if self._contact_force is None:
            return None
        try:
            force_n = float(self._contact_force(state))
        except Exception as error:
            return Violation("force", f"the contact force cannot be computed: {quoted(error)}")
        if math.isfinite(force_n) and abs(force_n) <= self._max_force_n:
            return None
        limit_n = self._max_force_n
        text = f"contact force is {force_n:.3g} N, above the limit of {limit_n:.3g} N"
        return Violation("force", text, value=force_n, limit=limit_n)


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
