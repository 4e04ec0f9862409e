"""A driver under test: its calls may hang and be abandoned, and checks report their findings."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Self, TypeVar

from skincal.hand.checks import StateCheck
from skincal.hand.commands import CommandCheck
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import Violation
from skincal.hand.halt import STOPPED, Stop, note_stop
from skincal.hand.worker import CallTimeoutError, Worker, call_and_leave

if TYPE_CHECKING:
    from skincal.hand.contract import ContractOptions

Rig = TypeVar("Rig")

CONNECT_S = 30.0
"""Longest time for connecting and closing [s]."""


class FailedCheckError(Exception):
    """A failed check; the text says what was found."""


class SkippedCheckError(Exception):
    """A check that does not apply; the text says why."""


class Trial:
    """A driver under test: calls that hang are abandoned, and every state and command is checked as by the guard."""

    def __init__(self, driver: HandDriver, options: ContractOptions, make: Callable[[], HandDriver]) -> None:
        self.driver, self.options, self.make = driver, options, make
        self._worker = Worker(f"trial {type(driver).__name__}")
        self._close_s = CONNECT_S
        name = getattr(driver, "name", type(driver).__name__)
        self.halt = Stop(lambda: self.driver.stop(), options.stop_s, name)
        note_stop(self.halt)
        self._check_state: StateCheck | None = None
        self._check_command: CommandCheck | None = None

    @classmethod
    def of(cls, make: Callable[[], HandDriver], options: ContractOptions) -> Self:
        """Create a driver and return its trial; errors are those of :func:`created`."""
        return cls(created(make), options, make)

    def call(self, work: Callable[..., Any], *arguments: Any, timeout_s: float | None = None) -> Any:
        """Make a call in the thread of the trial."""
        try:
            return self._worker.call(work, *arguments, timeout_s=timeout_s or self.options.call_s)
        except CallTimeoutError:
            self._close_s = self.options.stop_s
            raise

    def connect(self) -> None:
        """Connect the driver."""
        # First, as it may have to compile, and a connected hand is not to wait.
        force = self.options.contact_force(self.driver.description)
        self.call(self.driver.connect, timeout_s=CONNECT_S)
        self._check_state = StateCheck(self.driver, self.options.guard, force)
        self._check_command = CommandCheck(self.driver)

    def observe(self) -> HandState:
        """Return the next state if it is sound; else stop the hand."""
        start = time.monotonic()
        state = self.call(self.driver.observe)
        now = time.monotonic()
        if self._check_state is not None and self._check_command is not None:
            self._refuse(self._check_state(state, now, now - start))
            self._check_command.observed(state, now)
        return state

    def act(self, command: HandCommand) -> None:
        """Send a command if it is allowed; else stop the hand."""
        if self._check_command is not None:
            self._refuse(self._check_command(command, time.monotonic()))
            self._check_command.sent(command, time.monotonic())
        self.call(self.driver.act, command)

    def _refuse(self, violation: Violation | None) -> None:
        if violation is not None:
            raise FailedCheckError(f"{violation.text}. {self.halt() or STOPPED}")

    def states(self, count: int) -> list[HandState]:
        """Return a number of consecutive states."""
        return [self.observe() for _ in range(count)]

    def stop(self) -> float:
        """Stop the hand from another thread; return the duration [s]."""
        start = time.monotonic()
        try:
            call_and_leave(self.driver.stop, self.options.stop_s, "trial stop")
        except CallTimeoutError:
            raise FailedCheckError(f"stop() did not return within {self.options.stop_s:g} s") from None
        return time.monotonic() - start

    def end(self, close_s: float = CONNECT_S) -> str:
        """Stop the hand and release it, in whatever state it is; return the failure to stop, or ''."""
        trouble = self.halt()
        with suppress(Exception):
            # A driver with a hanging call cannot be closed; do not wait.
            self.call(self.driver.close, timeout_s=min(close_s, self._close_s))
        self._worker.end()
        return trouble


def created(make: Callable[[], Rig], timeout_s: float | None = None) -> Rig:
    """Create a driver, which may hang.

    Raises:
        CallTimeoutError: it was not created in time.
        CallExitError: it raised anything but an ``Exception``.
    """
    worker = Worker("make a driver")
    try:
        return worker.call(make, timeout_s=timeout_s or CONNECT_S)
    finally:
        worker.end()


def expect(good: bool, got: str) -> None:
    """Fail the check with what was found, if a condition does not hold."""
    if not good:
        raise FailedCheckError(got)
