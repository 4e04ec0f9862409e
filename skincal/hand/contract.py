"""The contract of drivers, as checks that run against a driver.

Each check creates its own driver, and moves no joint by more than ``step_rad``; the hand must be able to move that far
without touching anything. Calls are made as the guard makes them, so that a call that hangs fails only its own check.
Every state and command is checked as by the guard, including the contact force, and a hand that breaks a limit is
stopped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from skincal.errors import quoted
from skincal.hand.contract_checks import CHECKS, Check
from skincal.hand.driver import HandDriver
from skincal.hand.errors import HandError
from skincal.hand.guard_options import GuardOptions
from skincal.hand.halt import HURRY_S, STOPPED
from skincal.hand.state_checks import ContactForce
from skincal.hand.trial import FailedCheckError, SkippedCheckError, Trial
from skincal.hand.worker import CallTimeoutError, raised_by
from skincal.robot import HandDescription, joint_contact_force
from skincal.signals import held_back

PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"


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


def run_contract(
    name: str,
    make: Callable[[], HandDriver],
    options: ContractOptions | None = None,
    progress: Progress = lambda result: None,
) -> ContractReport:
    """Run every check against a driver of a hand."""
    chosen = options or ContractOptions()

    def attempt(check: Check, could_stop: bool) -> Outcome:
        return _attempt(check, make, replace(chosen, move=chosen.move and could_stop))

    return run_checks(name, CHECKS, attempt, progress)


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


def _attempt(
    check: Callable[[Trial], str | None], make: Callable[[], HandDriver], options: ContractOptions
) -> Outcome:
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
