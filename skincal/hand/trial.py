"""A hand under test: a guarded hand whose driver can also be called directly, and checks that report findings."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Self, TypeVar

from skincal.hand.driver import HandDriver, HandState
from skincal.hand.guard import GuardedHand
from skincal.hand.halt import note_stop
from skincal.hand.worker import CallTimeoutError, call_and_leave

if TYPE_CHECKING:
    from skincal.hand.contract import ContractOptions

Rig = TypeVar("Rig")

CONNECT_S = 30.0
"""Longest time for creating, connecting and closing [s]."""


class FailedCheckError(Exception):
    """A failed check; the text says what was found."""


class SkippedCheckError(Exception):
    """A check that does not apply; the text says why."""


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
