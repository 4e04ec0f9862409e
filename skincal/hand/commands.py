"""The guard's checks of a command before it is sent: form, joint limits, and step size for the time passed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from skincal.errors import shown
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import HandError, Violation

FloatArray = NDArray[np.float64]

FROZEN_S = 0.5
"""Longest time for which commands may move a rig whose measured values stay the same, as for a standing clock [s]."""

MOVED_RAD = 0.01
"""A command that moves by less need not show, as encoders and torque sensors are coarse [rad]."""

ROUNDING_RAD = 1e-9
"""Tolerance of a command's limits, as sums of steps are not exact [rad]."""


class Elapsed:
    """Clock of the time that bounds the step of a command.

    It is what has passed since the command before, on the rig's clock and on ours, whichever is less, and one period at
    most: a state that comes early, twice or with a clock that leaps earns no larger step. A simulated clock has nothing
    to do with ours, and counts alone. Before the first command the time is that since the first state.

    Args:
        real_time: whether the rig's clock runs as fast as ours.
        period_s: time between two states [s].
    """

    def __init__(self, *, real_time: bool, period_s: float) -> None:
        self._real_time, self._period_s = real_time, period_s
        self._rig_s = self._sent_rig_s = self._sent_own_s = math.nan

    def observed(self, rig_s: float, now_s: float) -> None:
        """Record the time of a sound state on the rig's clock [s], which arrived at ``now_s`` on ours."""
        self._rig_s = rig_s
        if math.isnan(self._sent_rig_s):
            self._sent_rig_s, self._sent_own_s = rig_s, now_s

    def sent(self, now_s: float) -> None:
        """Record that a command was sent; ``now_s`` is our clock afterwards [s]."""
        self._sent_rig_s, self._sent_own_s = self._rig_s, now_s

    def passed_s(self, now_s: float) -> float:
        """Return the time since the last command that counts [s]."""
        own_s = now_s - self._sent_own_s if self._real_time else math.inf
        return max(0.0, min(self._rig_s - self._sent_rig_s, own_s, self._period_s))


class FrozenCheck:
    """Check that measured values answer to commands: none is allowed on the strength of states that are frozen.

    A driver that gives old values with new stamps hides angles, torques and forces from every other check. Only values
    that are the same to the last bit count as frozen, and only while commands move the rig: one at rest whose encoders
    and torque sensors are coarse may well give the same values for long.

    Args:
        moved: by how much commands have to move any joint or axis.
        unit: unit of ``moved``.
    """

    def __init__(self, moved: float, unit: str) -> None:
        self._moved, self._unit = moved, unit
        self._values = self._command = self._base = np.empty(0)
        self._since_s = self._now_s = math.nan

    def observed(self, values: FloatArray, rig_s: float) -> None:
        """Record all values that the rig measured at ``rig_s`` on its clock [s]."""
        self._now_s = rig_s
        if not np.array_equal(values, self._values):
            self._values, self._since_s, self._base = values.copy(), rig_s, self._command

    def sent(self, command: FloatArray) -> None:
        """Record a command that was sent."""
        self._command = command.copy()
        if not self._base.size:
            self._base = self._command

    def __call__(self) -> Violation | None:
        """Return the violation of a command that is to be sent now; None if the rig has answered to those before."""
        for_s = self._now_s - self._since_s
        if not for_s > FROZEN_S or not self._base.size:
            return None
        moved = float(np.abs(self._command - self._base).max())
        if moved <= self._moved:
            return None
        text = (
            f"no measured value has changed for {for_s:.3g} s, while commands moved by {moved:.3g} {self._unit}: the "
            "states are frozen"
        )
        return Violation("state", text, value=for_s, limit=FROZEN_S)


class CommandCheck:
    """Checker of commands, one after the other.

    A command may differ from the previous one by at most velocity times time (:class:`Elapsed`). Before the first
    command the hand holds its reported angles.

    Args:
        driver: the connected hand.
    """

    def __init__(self, driver: HandDriver) -> None:
        description = driver.description
        self._joints, self._limits = description.joints, description.limits
        self._low = self._limits.lower_rad - ROUNDING_RAD
        self._high = self._limits.upper_rad + ROUNDING_RAD
        self._elapsed = Elapsed(real_time=driver.real_time, period_s=driver.period_s)
        # A recording answers to no command.
        self._frozen = FrozenCheck(MOVED_RAD if driver.follows_commands else math.inf, "rad")
        self._base_rad: FloatArray | None = None
        self._sent = False

    def observed(self, state: HandState, now_s: float) -> None:
        """Record a sound state that arrived at ``now_s`` on our clock [s]."""
        self._elapsed.observed(float(state.time_s), now_s)
        measured = (state.q_rad, state.dq_rad_per_s, state.tau_nm, state.q_desired_rad)
        self._frozen.observed(np.concatenate(measured), float(state.time_s))
        if not self._sent:
            self._base_rad = state.q_desired_rad.copy()

    def sent(self, command: HandCommand, now_s: float) -> None:
        """Record a command that the driver has sent; ``now_s`` is our clock afterwards [s]."""
        # Copy the array: the caller may reuse it.
        self._base_rad, self._sent = command.q_desired_rad.copy(), True
        self._elapsed.sent(now_s)
        self._frozen.sent(command.q_desired_rad)

    def __call__(self, command: HandCommand, now_s: float) -> Violation | None:
        """Return the violation of a command that is to be sent now; None if it is allowed."""
        before_rad = self._before()
        if not isinstance(command, HandCommand):  # pyright: ignore[reportUnnecessaryIsInstance]
            return Violation("command", f"expected a HandCommand; got {shown(command)}")
        q, shape = command.q_desired_rad, before_rad.shape
        if type(q) is not np.ndarray or q.shape != shape or q.dtype != np.float64:
            text = f"command, q_desired_rad: expected an array of float64 of shape {shape}; got {shown(q)}"
            return Violation("command", text)
        if frozen := self._frozen():
            return frozen
        largest = self._step_rad(now_s)
        small = np.abs(q - before_rad) <= largest + ROUNDING_RAD
        if ((q >= self._low) & (q <= self._high) & small).all():
            return None
        return self._named(q, np.abs(q - before_rad), largest, now_s)

    def nearest(self, q_rad: FloatArray, now_s: float) -> FloatArray:
        """Return the allowed angles (n,) [rad] nearest to ``q_rad``, joint by joint."""
        before_rad, step = self._before(), self._step_rad(now_s)
        near = np.clip(q_rad, before_rad - step, before_rad + step)
        return np.clip(near, self._limits.lower_rad, self._limits.upper_rad)

    def _before(self) -> FloatArray:
        if self._base_rad is None:
            raise HandError("observe a state before the first command", "order")
        return self._base_rad

    def _step_rad(self, now_s: float) -> FloatArray:
        return self._limits.velocity_rad_per_s * self._elapsed.passed_s(now_s)

    def _named(self, q: FloatArray, step: FloatArray, largest: FloatArray, now_s: float) -> Violation | None:
        for j, name in enumerate(self._joints):
            value = float(q[j])
            low, high = float(self._limits.lower_rad[j]), float(self._limits.upper_rad[j])
            if not math.isfinite(value):
                return Violation("command", f"joint {name}: commanded angle is {value}", name, value)
            if not self._low[j] <= value <= self._high[j]:
                text = f"joint {name}: commanded angle {value:.4g} rad lies outside its limits [{low:.4g}, {high:.4g}]"
                return Violation("command", text, name, value, low if value < low else high)
            if step[j] > largest[j] + ROUNDING_RAD:
                speed, passed_s = float(self._limits.velocity_rad_per_s[j]), self._elapsed.passed_s(now_s)
                text = (
                    f"joint {name}: commanded angle steps by {step[j]:.4g} rad; at {speed:.4g} rad/s and "
                    f"{1e3 * passed_s:.3g} ms since the last command at most {largest[j]:.4g} rad are allowed"
                )
                return Violation("command", text, name, float(step[j]), float(largest[j]))
        return None
