"""Stopping a hand, or another rig, so that nothing cuts it short, and saying truly whether it was stopped."""

from __future__ import annotations

from collections.abc import Callable

from skincal.errors import quoted
from skincal.hand.worker import CallExitError, CallTimeoutError, call_and_leave
from skincal.signals import held_back


def stopped(rig: str) -> str:
    """Return the statement that a rig was stopped, valid only after its ``stop`` returned."""
    return f"The {rig} was stopped."


STOPPED = stopped("hand")

HURRY_S = 2.0
"""Longest time for closing while somebody waits for the end [s]."""


def halt(stop: Callable[[], None], timeout_s: float, name: str, rig: str = "hand") -> str:
    """Call a driver's ``stop``, a second time if it raises; it takes at most ``timeout_s`` and is not interrupted.

    Returns:
        What went wrong with it; empty: it returned, the rig is stopped.
    """
    trouble, power = "", f"Cut the {rig}'s power."
    with held_back():
        for _ in range(2):
            try:
                call_and_leave(stop, timeout_s, f"stop {name}")
                return ""
            except CallTimeoutError:
                return f"stop() did not return within {timeout_s:g} s! {power}"
            except Exception as error:
                raised = error.__cause__ if isinstance(error, CallExitError) else error
                trouble = f"stop() failed! {quoted(raised or error)}. {power}"
    return trouble
