"""A driver on trial: calls that may hang can be left, and what a check finds."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from skincal.hand.checks import StateCheck
from skincal.hand.commands import CommandCheck
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import Violation
from skincal.hand.halt import STOPPED, halt
from skincal.hand.worker import CallTimeoutError, Worker, call_and_leave

if TYPE_CHECKING:
    from skincal.hand.contract import ContractOptions

CONNECT_S = 30.0
"""Connecting and closing may take so long [s]."""


class FailedCheckError(Exception):
    """A check failed; the text says what came."""


class SkippedCheckError(Exception):
    """A check does not apply; the text says why."""


class Trial:
    """A driver on trial: calls that may hang can be left, and every state and command is checked as the guard does.

    Args:
        driver: a fresh driver.
        options: how it is tried.
        make: makes another one.
    """

    def __init__(self, driver: HandDriver, options: ContractOptions, make: Callable[[], HandDriver]) -> None:
        self.driver, self.options, self.make = driver, options, make
        self._worker = Worker(f"trial {type(driver).__name__}")
        self._close_s = CONNECT_S
        self._check_state: StateCheck | None = None
        self._check_command: CommandCheck | None = None

    def call(self, work: Callable[..., Any], *arguments: Any, timeout_s: float | None = None) -> Any:
        """Make a call in the trial's thread."""
        try:
            return self._worker.call(work, *arguments, timeout_s=timeout_s or self.options.call_s)
        except CallTimeoutError:
            self._close_s = self.options.stop_s
            raise

    def connect(self) -> None:
        """Connect the driver."""
        self.call(self.driver.connect, timeout_s=CONNECT_S)
        force = self.options.contact_force(self.driver.description)
        self._check_state = StateCheck(self.driver, self.options.guard, force)
        self._check_command = CommandCheck(self.driver)

    def observe(self) -> HandState:
        """Return the next state, if it is sound; else the hand is stopped."""
        start = time.monotonic()
        state = self.call(self.driver.observe)
        now = time.monotonic()
        if self._check_state is not None and self._check_command is not None:
            self._refuse(self._check_state(state, now, now - start))
            self._check_command.observed(state, now)
        return state

    def act(self, command: HandCommand) -> None:
        """Send a command, if it is allowed; else the hand is stopped."""
        if self._check_command is not None:
            self._refuse(self._check_command(command, time.monotonic()))
            self._check_command.sent(command, time.monotonic())
        self.call(self.driver.act, command)

    def _refuse(self, violation: Violation | None) -> None:
        if violation is not None:
            raise FailedCheckError(f"{violation.text}. {self.halt() or STOPPED}")

    def states(self, count: int) -> list[HandState]:
        """That many states in a row."""
        return [self.observe() for _ in range(count)]

    def stop(self) -> float:
        """Stop the hand from another thread; returns how long that took [s]."""
        start = time.monotonic()
        try:
            call_and_leave(self.driver.stop, self.options.stop_s, "trial stop")
        except CallTimeoutError:
            raise FailedCheckError(f"stop() did not return within {self.options.stop_s:g} s") from None
        return time.monotonic() - start

    def halt(self) -> str:
        """Stop the hand. Returns what went wrong with that; empty: it was stopped."""
        return halt(self.driver.stop, self.options.stop_s, self.driver.name)

    def end(self, close_s: float = CONNECT_S) -> str:
        """Stop the hand and gives it back, whatever state it is in. Returns what went wrong with stopping it."""
        trouble = self.halt()
        with suppress(Exception):
            # Behind a call that hangs there is no closing, and nothing to wait for.
            self.call(self.driver.close, timeout_s=min(close_s, self._close_s))
        self._worker.end()
        return trouble


def expect(good: bool, got: str) -> None:
    """Fail the check, saying what came, where it is not as it should be."""
    if not good:
        raise FailedCheckError(got)
