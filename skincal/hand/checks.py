"""Checks that the guards of a hand and of a stage share: the rig's clock, its taxels, and the steps of its commands.

The checks run in every period. A good state passes with a few array operations; only if one fails is the part at fault
determined.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Generic, TypeVar

import numpy as np

from skincal.dataset import SensorSpec
from skincal.dataset.columns import LARGEST
from skincal.errors import shown
from skincal.hand.driver import HandCommand, HandDriver, HandState, StageDriver, StageState
from skincal.hand.errors import HandError, is_number
from skincal.hand.guard_options import GuardOptions
from skincal.model.arrays import FloatArray

DRIFT = 1e-3
"""Largest relative difference of two clocks that run equally fast; cheap crystals keep a tenth of it."""

SLOWEST = 10.0
"""A simulated clock may be slower than ours by this factor while we wait for it, and faster without limit."""

JUMP_S = 0.1
"""Largest jump of the hand's clock over ours between two states, or five periods if that is more: a bus delivers in
bursts, and a busy computer looks late [s]."""


class ClockCheck:
    """Checker of the time of each state, one after the other.

    The lag is a leaky sum: the advance of our clock between two states less that of the hand's, never below zero. So it
    is the lag behind the earliest state, and clocks that differ by `DRIFT` do not add up over a long session.

    Args:
        options: limits.
        real_time: whether the hand's clock runs as fast as ours.
        period_s: time between two states [s].
        recorded: whether the states come from a recording, which may have gaps.
    """

    def __init__(
        self, options: GuardOptions, *, real_time: bool, period_s: float, recorded: bool = False
    ) -> None:
        self._options, self._real_time, self._recorded = options, real_time, recorded
        self._jump_s = max(JUMP_S, 5 * period_s)
        lag_s = math.inf if options.lag_s is None else options.lag_s
        # Slow calls of a simulated hand, as over a bad network, allow later states.
        self._lag_s = lag_s if real_time else max(lag_s, options.timeout_s / 2)
        self._last_s = self._now_s = self._advanced_s = math.nan
        self._behind_s = self._ahead_s = 0.0

    def __call__(self, time_s: float, now_s: float, waited_s: float) -> None:
        """Check a state's time.

        Args:
            time_s: the hand's clock [s].
            now_s: our clock at the arrival of the state [s].
            waited_s: time that the driver took for it [s].

        Raises:
            HandError: a violation.
        """
        if not math.isfinite(time_s):
            raise HandError(f"the hand's clock says {time_s}, which is not finite", "clock", value=time_s)
        if math.isnan(self._last_s):
            self._last_s, self._now_s, self._advanced_s = time_s, now_s, now_s
            return
        step_s, passed_s, last_s = time_s - self._last_s, now_s - self._now_s, self._last_s
        if step_s < 0:
            text = f"the hand's clock went back, from {last_s:.6f} s to {time_s:.6f} s"
            raise HandError(text, "clock", value=time_s, limit=last_s)
        self._last_s, self._now_s = time_s, now_s
        if step_s > 0:
            self._advanced_s = now_s
        for_s, limit_s = now_s - self._advanced_s, self._options.stale_s
        if for_s > limit_s:
            text = (
                f"the hand's clock has stood at {time_s:.6f} s for {for_s:.3g} s, the limit is {limit_s:g} s: "
                "the states are stale"
            )
            raise HandError(text, "clock", value=for_s, limit=limit_s)
        # A state whose answer was lost on its way comes late, and the next one does not.
        more_s = self._jump_s + (self._behind_s if self._real_time else 0.0)
        if step_s > passed_s + more_s and not self._recorded:
            text = (
                f"the hand's clock jumped by {step_s:.4g} s within {passed_s:.3g} s of ours; at most "
                f"{more_s:.3g} s more are allowed"
            )
            raise HandError(text, "clock", value=step_s, limit=passed_s + more_s)
        self._check_lag(step_s, passed_s, waited_s)

    def _check_lag(self, step_s: float, passed_s: float, waited_s: float) -> None:
        limit_s = self._lag_s
        if self._real_time:
            self._behind_s = max(0.0, self._behind_s + passed_s - (1 + DRIFT) * step_s)
            self._ahead_s = max(0.0, self._ahead_s + step_s - (1 + DRIFT) * passed_s)
        else:
            self._behind_s = max(0.0, self._behind_s + waited_s - SLOWEST * step_s)
        if self._behind_s > limit_s:
            behind_s = self._behind_s
            text = f"the states come {behind_s:.3g} s late, the limit is {limit_s:g} s: they are stale"
            raise HandError(text, "clock", value=behind_s, limit=limit_s)
        if self._ahead_s > limit_s:
            ahead_s = self._ahead_s
            text = (
                f"the hand's clock runs {ahead_s:.3g} s ahead of ours, the limit is {limit_s:g} s; the driver of a "
                "simulated hand says real_time = False"
            )
            raise HandError(text, "clock", value=ahead_s, limit=limit_s)


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


FROZEN_S = 0.5
"""Longest time for which a position may stay the same after its command has moved, as for a standing clock [s]."""


State = TypeVar("State", HandState, StageState)
Command = TypeVar("Command", HandCommand, FloatArray)


class StepCheck(ABC, Generic[State, Command]):
    """Checker of commands, one after the other: a command may differ from the one before by speed times time.

    The time is what has passed since the command before, on the rig's clock and on ours, whichever is less, and one
    period at most: a state that comes early, twice or with a clock that leaps earns no larger step. A simulated clock
    has nothing to do with ours, and counts alone. Before the first command the time is that since the first state, and
    the rig holds to where it is.

    No command is allowed on the strength of states that are frozen: old values with new stamps hide positions and
    forces from every other check. Positions follow commands, each joint or axis on its own, so each of them must change
    when its command has moved, unless forces take the way of the command, or friction does while other values change.
    Nothing else has to change: a torque, a force or a velocity may rightly stay the same in free motion. Only values
    that are the same to the last bit count as frozen, as those of a coarse encoder at rest may be for long.

    Args:
        driver: the rig.
        names: names of the joints or axes.
        moved: by how much a command has to move for the position to change.
        sticks: by how much more, (n,), where a joint may stick.
        unit: unit of commands.
    """

    def __init__(
        self,
        driver: HandDriver | StageDriver,
        names: Sequence[str],
        moved: float,
        sticks: FloatArray,
        unit: str,
    ) -> None:
        self._names, self._moved, self._sticks, self._unit = names, moved, sticks, unit
        self._real_time, self._period_s = driver.real_time, driver.period_s
        self._rig_s = self._sent_rig_s = self._sent_own_s = math.nan
        self._base: FloatArray | None = None
        self._sent = False
        self._measured = np.empty(0)
        # Command and give when the position last changed; by how much the command is ahead, and when it last was not.
        self._place_base = self._place_give = self._ahead = self._sound_s = np.full(len(names), math.nan)

    @abstractmethod
    def _read(self, state: State) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return where a rig without a command holds, how far it gives way to forces, and what it measured.

        All are copies. The first two are (n,), in the unit of commands; measured values are (k, n), positions first.
        """

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
        held, give, measured = self._read(state)
        if self._base is None or not self._sent:
            self._base = held
        moved = np.full(len(held), True) if not self._sent else measured[0] != self._measured[0]
        sticks = 0.0 if np.array_equal(measured, self._measured) else self._sticks
        self._measured = measured
        self._place_base = np.where(moved, self._base, self._place_base)
        self._place_give = np.where(moved, give, self._place_give)
        self._ahead = np.abs(self._base - self._place_base) - np.abs(give - self._place_give)
        self._sound_s = np.where(self._ahead > self._moved + sticks, self._sound_s, self._rig_s)

    def sent(self, command: Command, now_s: float) -> None:
        """Record a command that the driver has sent; ``now_s`` is our clock afterwards [s]."""
        target = command.q_desired_rad if isinstance(command, HandCommand) else command
        self._base, self._sent = np.array(target, dtype=np.float64), True  # the caller may reuse its array
        self._sent_rig_s, self._sent_own_s = self._rig_s, now_s

    def _check_frozen(self) -> None:
        """Check that every joint or axis has answered to the commands up to the last one."""
        j = int(np.argmin(self._sound_s))
        for_s, moved = self._rig_s - float(self._sound_s[j]), float(self._ahead[j])
        if for_s > FROZEN_S:
            text = (
                f"{self._names[j]}: the measured position has not changed for {for_s:.3g} s, while commands moved by "
                f"{moved:.3g} {self._unit}: the states are frozen"
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
