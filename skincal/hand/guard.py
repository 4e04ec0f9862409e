"""The guard of a hand: what stands between a hand and whoever moves it (:mod:`skincal.hand.guard_calls`)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from skincal.errors import quoted, shown
from skincal.hand.checks import ClockCheck, StepCheck, TaxelCheck, check_numbers
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import HandError, HandErrorKind
from skincal.hand.guard_calls import Guarded
from skincal.hand.guard_options import GuardOptions
from skincal.model.arrays import FloatArray
from skincal.robot import HandDescription, check_limits
from skincal.robot.description import JOINT_FIELDS, NUMBERS, TAXEL_FIELDS

TEMPERATURES_C = (-273.15, 1000.0)
"""Lowest and highest temperature of a skin [deg C]; anything beyond is a fault of the sensor or its driver."""

MOVED_RAD = 0.01
"""A command that moves by less need not show, as encoders are coarse [rad]."""

STICKS = 0.1
"""Largest stick friction of a joint, relative to its largest torque: an assumption; the last joints of the simulated
hand have 0.06."""

ROUNDING_RAD = 1e-9
"""Tolerance of a command's limits, as sums of steps are not exact [rad]."""

ContactForce = Callable[[HandState], float]


class GuardedHand(Guarded[HandDescription, HandState, HandCommand]):
    """A hand that is safe to move; arguments are those of :class:`~skincal.hand.guard_calls.Guarded`.

    Args:
        contact_force: the contact force of a state [N], from its joint angles and torques; None: not checked.
    """

    rig = "hand"

    def __init__(
        self,
        driver: HandDriver,
        options: GuardOptions | None = None,
        contact_force: ContactForce | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(driver, options, clock)
        self._contact_force = contact_force

    def object_position_m(self) -> FloatArray:
        """Return where the hand sees the object (2,) [m]; NaN: it does not.

        Raises:
            HandError: the driver gave something else, failed or did not return; the hand has been stopped.
        """
        what = "object_position_m"
        place = self._call(what, self._made.object_position_m, timeout_s=self._options.timeout_s)
        if place is None:
            return np.full(2, np.nan)
        numbers = type(place) is np.ndarray and place.shape == (2,) and place.dtype == np.float64
        if not numbers or np.isinf(place).any():
            expected = "None, or an array of float64 of shape (2,), finite or NaN"
            self._fail(HandError(f"{what}: expected {expected}; got {shown(place)}", "state"))
        return place.copy()

    def _check_limits(self) -> None:
        check_limits(self.description, beyond=self._options.beyond_limits)

    def _checks(self) -> tuple[StateCheck, CommandCheck]:
        return StateCheck(self._made, self._options, self._contact_force), CommandCheck(self._made)


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


class CommandCheck(StepCheck[HandState, HandCommand]):
    """Checker of the commands of a hand."""

    def __init__(self, driver: HandDriver) -> None:
        description = driver.description
        # A recording answers to no command.
        moved_rad = MOVED_RAD if driver.follows_commands else math.inf
        self._stiffness = description.gains.stiffness_nm_per_rad
        # Friction of either sign.
        sticks_rad = 2 * STICKS * description.limits.torque_nm / self._stiffness
        names = [f"joint {name}" for name in description.joints]
        super().__init__(driver, names, moved_rad, sticks_rad, "rad")
        self._joints, self._limits = description.joints, description.limits
        self._low = self._limits.lower_rad - ROUNDING_RAD
        self._high = self._limits.upper_rad + ROUNDING_RAD

    def _read(self, state: HandState) -> tuple[FloatArray, FloatArray, FloatArray]:
        # A joint that something blocks turns the way of its command into torque.
        give = state.tau_nm / self._stiffness
        measured = np.stack((state.q_rad, state.dq_rad_per_s, state.tau_nm, state.q_desired_rad))
        return state.q_desired_rad.copy(), give, measured

    def __call__(self, command: HandCommand, now_s: float) -> None:
        """See :meth:`StepCheck.__call__`."""
        before_rad = self._before()
        if not isinstance(command, HandCommand):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise HandError(f"expected a HandCommand; got {shown(command)}", "command")
        q, shape = command.q_desired_rad, before_rad.shape
        if type(q) is not np.ndarray or q.shape != shape or q.dtype != np.float64:
            text = f"command, q_desired_rad: expected an array of float64 of shape {shape}; got {shown(q)}"
            raise HandError(text, "command")
        self._check_frozen()
        largest = self._step_rad(now_s)
        small = np.abs(q - before_rad) <= largest + ROUNDING_RAD
        if not ((q >= self._low) & (q <= self._high) & small).all():
            self._refuse(q, np.abs(q - before_rad), largest, now_s)

    def nearest(self, target: FloatArray, now_s: float) -> HandCommand:
        """Return the allowed command nearest to angles (n,) [rad], joint by joint."""
        before_rad, step = self._before(), self._step_rad(now_s)
        near = np.clip(target, before_rad - step, before_rad + step)
        return HandCommand(np.clip(near, self._limits.lower_rad, self._limits.upper_rad))

    def _step_rad(self, now_s: float) -> FloatArray:
        return self._limits.velocity_rad_per_s * self._passed_s(now_s)

    def _refuse(self, q: FloatArray, step: FloatArray, largest: FloatArray, now_s: float) -> None:
        for j, name in enumerate(self._joints):
            value = float(q[j])
            low, high = float(self._limits.lower_rad[j]), float(self._limits.upper_rad[j])
            if not math.isfinite(value):
                text = f"joint {name}: commanded angle is {value}"
                raise HandError(text, "command", joint=name, value=value)
            if not self._low[j] <= value <= self._high[j]:
                text = f"joint {name}: commanded angle {value:.4g} rad lies outside its limits [{low:.4g}, {high:.4g}]"
                raise HandError(text, "command", joint=name, value=value, limit=low if value < low else high)
            if step[j] > largest[j] + ROUNDING_RAD:
                speed, passed_s = float(self._limits.velocity_rad_per_s[j]), self._passed_s(now_s)
                text = (
                    f"joint {name}: commanded angle steps by {step[j]:.4g} rad; at {speed:.4g} rad/s and "
                    f"{1e3 * passed_s:.3g} ms since the last command at most {largest[j]:.4g} rad are allowed"
                )
                raise HandError(text, "command", joint=name, value=float(step[j]), limit=float(largest[j]))


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
