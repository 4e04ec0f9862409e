"""Checks of drivers against the contract: how they are run, and the hand or stage under test.

Each check creates its own driver. Calls are made as the guard makes them, so that a call that hangs fails only its own
check. Every state and command is checked as by the guard, including the contact force, and a rig that breaks a limit
is stopped. The checks are in :mod:`skincal.hand.contract_checks` and :mod:`skincal.hand.stage_checks`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Self, TypeVar

from skincal.errors import quoted
from skincal.hand.calls import HURRY_S, STOPPED, CallTimeoutError, call_and_leave, note_stop, raised_by
from skincal.hand.driver import HandDriver, HandState
from skincal.hand.errors import HandError
from skincal.hand.guard import ContactForce, GuardedHand
from skincal.hand.guard_options import GuardOptions
from skincal.robot import HandDescription, joint_contact_force
from skincal.signals import held_back

PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"

CONNECT_S = 30.0
"""Longest time for creating, connecting and closing [s]."""


Rig = TypeVar("Rig")

Check = Callable[..., str | None]
"""A check: of a hand it takes a trial; it returns what was measured, or raises."""


class FailedCheckError(Exception):
    """A failed check; the text says what was found."""


class SkippedCheckError(Exception):
    """A check that does not apply; the text says why."""


@dataclass(frozen=True)
class ContractOptions:
    """Options of the checks.

    Attributes:
        step_rad: largest motion of a joint [rad].
        periods: number of states that are checked in a row.
        call_s: largest duration of a call to the driver [s].
        stop_s: largest duration of ``stop`` [s].
        move: whether to move the hand; one that could not be stopped is not moved.
        beyond_limits: whether the limits of its description may exceed those of any finger.
        contact_force: creates the function that computes the contact force of a state.
        clock: our clock [s].
    """

    step_rad: float = 0.02
    periods: int = 50
    call_s: float = 1.0
    stop_s: float = 0.5
    move: bool = True
    beyond_limits: bool = False
    contact_force: Callable[[HandDescription], ContactForce] = joint_contact_force
    clock: Callable[[], float] = time.monotonic

    @property
    def guard(self) -> GuardOptions:
        """Return the options of the guard during the checks."""
        return GuardOptions(
            timeout_s=self.call_s, stop_timeout_s=self.stop_s, idle_s=None, beyond_limits=self.beyond_limits
        )


@dataclass(frozen=True)
class CheckResult:
    """Result of a check.

    Attributes:
        status: ``passed``, ``failed`` or ``skipped``.
        got: the actual behaviour, the reason for skipping, or the measured values.
    """

    name: str
    expected: str
    status: str
    got: str
    time_s: float


@dataclass(frozen=True)
class ContractReport:
    """Results of all checks of a driver."""

    driver: str
    results: tuple[CheckResult, ...]

    @property
    def ok(self) -> bool:
        """True if no check failed."""
        return all(result.status != FAILED for result in self.results)

    def count(self, status: str) -> int:
        """Return the number of checks with a status."""
        return sum(result.status == status for result in self.results)


Outcome = tuple[str, str, bool]
"""Status of a check, what was found, and False if the rig could not be stopped."""

Progress = Callable[[CheckResult], None]


def run_checks(
    name: str, checks: Sequence[Check], attempt: Callable[[Check, bool], Outcome], progress: Progress
) -> ContractReport:
    """Run checks one after the other.

    Args:
        name: the driver's name, for the report.
        checks: functions with the check's name, and the expected behaviour for a docstring.
        attempt: runs a check, given whether the rig could be stopped after all checks before.
        progress: callback with every result.
    """
    results: list[CheckResult] = []
    move = True
    for check in checks:
        start = time.monotonic()
        status, got, stopped = attempt(check, move)
        move = move and stopped
        title, expected = check.__name__.replace("_", " "), (check.__doc__ or "").strip().rstrip(".")
        results.append(CheckResult(title, expected, status, got, time.monotonic() - start))
        progress(results[-1])
    return ContractReport(name, tuple(results))


def outcome(run: Callable[[], str | None], limit_s: float) -> Outcome:
    """Run a check; return its outcome.

    Args:
        run: the check; it returns what was measured, or raises.
        limit_s: longest duration of a call, for the report [s].

    Raises:
        KeyboardInterrupt: the user's.
        HandError: the user interrupted, and the hand could not be stopped.
    """
    try:
        return PASSED, run() or "", True
    except SkippedCheckError as why:
        return SKIPPED, str(why), True
    except FailedCheckError as why:
        return FAILED, str(why), True
    except CallTimeoutError:
        return FAILED, f"a call that did not return within {limit_s:g} s", True
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        unstopped = isinstance(error, HandError) and error.stopped is False
        if unstopped and isinstance(error.__cause__, KeyboardInterrupt):
            raise
        text = str(error) if isinstance(error, HandError) else quoted(raised_by(error))
        return FAILED, text, not unstopped


class Trial(GuardedHand):
    """A hand under test: every state and command is checked, and calls that hang are abandoned."""

    def __init__(self, driver: HandDriver, options: ContractOptions, make: Callable[[], HandDriver]) -> None:
        super().__init__(driver, options.guard, clock=options.clock)
        self.driver, self.options, self.make = driver, options, make
        note_stop(self._halt)  # it may move before it is connected

    @classmethod
    def of(cls, make: Callable[[], HandDriver], options: ContractOptions) -> Self:
        """Create a driver and return its trial."""
        return cls(created(make), options, make)

    def connect(self) -> None:
        """Connect the driver."""
        # First, as it may have to compile, and a connected hand is not to wait.
        self._contact_force = self.options.contact_force(self.description)
        super().connect()

    def states(self, count: int) -> list[HandState]:
        """Return a number of consecutive states."""
        return [self.observe() for _ in range(count)]

    def own_state(self) -> HandState:
        """Return the next state, checked, as the driver gives it: it may share its arrays with others."""
        start_s = self._clock()
        state: HandState = self._call("observe", self.driver.observe, timeout_s=self.options.call_s)
        self._checked(state, start_s)
        return state

    def time_stop(self) -> float:
        """Stop the hand from another thread; return the duration [s]."""
        start = time.monotonic()
        try:
            call_and_leave(self.driver.stop, self.options.stop_s, "trial stop")
        except CallTimeoutError:
            raise FailedCheckError(f"stop() did not return within {self.options.stop_s:g} s") from None
        return time.monotonic() - start

    def end(self, close_s: float = CONNECT_S) -> str:
        """Stop the hand and release it, in whatever state it is; return the failure to stop, or ''."""
        trouble = self._halt()
        with suppress(Exception):
            call_and_leave(self.driver.close if self._worker is None else self.close, close_s, "trial end")
        return trouble


def created(make: Callable[[], Rig], timeout_s: float | None = None) -> Rig:
    """Create a driver, which may hang.

    Raises:
        CallTimeoutError: it was not created in time.
        CallExitError: it raised anything but an ``Exception``.
    """
    return call_and_leave(make, timeout_s or CONNECT_S, "make a driver")


def close_directly(driver: Any) -> None:
    """Call ``close`` of a driver that is not connected, or not any more."""
    call_and_leave(driver.close, CONNECT_S, "close")


def expect(good: bool, got: str) -> None:
    """Fail the check with what was found, if a condition does not hold."""
    if not good:
        raise FailedCheckError(got)


def try_hand(check: Check, make: Callable[[], HandDriver], options: ContractOptions) -> Outcome:
    """Run a check on a new hand, and stop and release it; return the outcome."""
    trial: Trial | None = None

    def run() -> str | None:
        nonlocal trial
        trial = Trial.of(make, options)
        return check(trial)

    try:
        status, got, stopped = outcome(run, options.call_s)
        trouble = "" if trial is None else trial.end()
        if trouble:
            status, got = FAILED, f"{got}. {trouble}".removeprefix(". ")
    except KeyboardInterrupt as interrupt:
        with held_back() as came:
            trouble = "" if trial is None else trial.end(HURRY_S)
            # The process is ending already, and the result must be reported.
            came.clear()
        if trouble:
            raise HandError(f"interrupted; {trouble}", "driver", stopped=False) from interrupt
        interrupt.add_note(STOPPED)
        raise
    return status, got, stopped and not trouble
