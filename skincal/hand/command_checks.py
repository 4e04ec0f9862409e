"""The guard's checks of a command before it is sent: form, joint limits, and step size for the time passed."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Generic, TypeVar

import numpy as np

from skincal.errors import shown
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import HandError
from skincal.hand.stage import StageDriver, StageState
from skincal.model.arrays import FloatArray

FROZEN_S = 0.5
"""Longest time for which commands may move a rig whose measured values stay the same, as for a standing clock [s]."""

MOVED_RAD = 0.01
"""A command that moves by less need not show, as encoders and torque sensors are coarse [rad]."""

ROUNDING_RAD = 1e-9
"""Tolerance of a command's limits, as sums of steps are not exact [rad]."""


State = TypeVar("State", HandState, StageState)
Command = TypeVar("Command", HandCommand, FloatArray)


class StepCheck(ABC, Generic[State, Command]):
    """Checker of commands, one after the other: a command may differ from the one before by speed times time.

    The time is what has passed since the command before, on the rig's clock and on ours, whichever is less, and one
    period at most: a state that comes early, twice or with a clock that leaps earns no larger step. A simulated clock
    has nothing to do with ours, and counts alone. Before the first command the time is that since the first state, and
    the rig holds to where it is.

    No command is allowed on the strength of states that are frozen. A driver that gives old values with new stamps
    hides angles, torques and forces from every other check. Only values that are the same to the last bit count as
    frozen, and only while commands move the rig: one at rest whose encoders and torque sensors are coarse may well give
    the same values for long.

    Args:
        driver: the rig.
        moved: by how much commands have to move any joint or axis for values to change.
        unit: unit of ``moved``.
    """

    def __init__(self, driver: HandDriver | StageDriver, moved: float, unit: str) -> None:
        self._moved, self._unit = moved, unit
        self._real_time, self._period_s = driver.real_time, driver.period_s
        self._rig_s = self._sent_rig_s = self._sent_own_s = self._same_since_s = math.nan
        self._base: FloatArray | None = None
        self._sent = False
        self._measured = np.empty(0)
        self._same_since: FloatArray | None = None

    @abstractmethod
    def _read(self, state: State) -> tuple[FloatArray, FloatArray]:
        """Return what a rig without a command holds to, and all values that it measured, as copies."""

    @abstractmethod
    def __call__(self, command: Command, now_s: float) -> None:
        """Check a command that is to be sent now.

        Raises:
            HandError: it is not allowed.
        """

    @abstractmethod
    def nearest(self, target: FloatArray, now_s: float) -> Command:
        """Return the allowed command nearest to a target (n,), as of now."""

    def observed(self, state: State, now_s: float) -> None:
        """Record a sound state that arrived at ``now_s`` on our clock [s]."""
        self._rig_s = float(state.time_s)
        if math.isnan(self._sent_rig_s):
            self._sent_rig_s, self._sent_own_s = self._rig_s, now_s
        held, measured = self._read(state)
        if not np.array_equal(measured, self._measured):
            self._measured, self._same_since_s = measured, self._rig_s
            self._same_since = self._base if self._sent else None
        if not self._sent:
            self._base = held

    def sent(self, command: Command, now_s: float) -> None:
        """Record a command that the driver has sent; ``now_s`` is our clock afterwards [s]."""
        target = command.q_desired_rad if isinstance(command, HandCommand) else command
        self._base, self._sent = np.array(target, dtype=np.float64), True  # the caller may reuse its array
        self._sent_rig_s, self._sent_own_s = self._rig_s, now_s
        if self._same_since is None:
            self._same_since = self._base

    def _check_frozen(self, base: FloatArray) -> None:
        """Check that the rig has answered to the commands up to the last one, ``base``."""
        for_s = self._rig_s - self._same_since_s
        if not for_s > FROZEN_S or self._same_since is None:
            return
        moved = float(np.abs(base - self._same_since).max())
        if moved > self._moved:
            text = (
                f"no measured value has changed for {for_s:.3g} s, while commands moved by {moved:.3g} {self._unit}: "
                "the states are frozen"
            )
            raise HandError(text, "state", value=for_s, limit=FROZEN_S)

    def _passed_s(self, now_s: float) -> float:
        """Return the time since the last command that counts [s]."""
        own_s = now_s - self._sent_own_s if self._real_time else math.inf
        return max(0.0, min(self._rig_s - self._sent_rig_s, own_s, self._period_s))

    def _before(self) -> FloatArray:
        if self._base is None:
            raise HandError("observe a state before the first command", "order")
        return self._base


class CommandCheck(StepCheck[HandState, HandCommand]):
    """Checker of the commands of a hand."""

    def __init__(self, driver: HandDriver) -> None:
        # A recording answers to no command.
        super().__init__(driver, MOVED_RAD if driver.follows_commands else math.inf, "rad")
        description = driver.description
        self._joints, self._limits = description.joints, description.limits
        self._low = self._limits.lower_rad - ROUNDING_RAD
        self._high = self._limits.upper_rad + ROUNDING_RAD

    def _read(self, state: HandState) -> tuple[FloatArray, FloatArray]:
        measured = np.concatenate((state.q_rad, state.dq_rad_per_s, state.tau_nm, state.q_desired_rad))
        return state.q_desired_rad.copy(), measured

    def __call__(self, command: HandCommand, now_s: float) -> None:
        """See :meth:`StepCheck.__call__`."""
        before_rad = self._before()
        if not isinstance(command, HandCommand):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise HandError(f"expected a HandCommand; got {shown(command)}", "command")
        q, shape = command.q_desired_rad, before_rad.shape
        if type(q) is not np.ndarray or q.shape != shape or q.dtype != np.float64:
            text = f"command, q_desired_rad: expected an array of float64 of shape {shape}; got {shown(q)}"
            raise HandError(text, "command")
        self._check_frozen(before_rad)
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
        """Raise the violation of the first joint that has one."""
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
