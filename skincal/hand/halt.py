"""Stopping a hand, or another rig, so that nothing cuts it short, and saying truly whether it was stopped."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from types import FrameType

from skincal.hand.worker import CallExitError, CallTimeoutError, call_and_leave


def stopped(rig: str) -> str:
    """What is said of a rig whose ``stop`` returned, and of no other."""
    return f"The {rig} was stopped."


STOPPED = stopped("hand")

HURRY_S = 2.0
"""Longest time for closing while somebody waits for the end [s]."""

_OTHERS = {
    *(signal.SIGKILL, signal.SIGSTOP),  # cannot be caught
    *(signal.SIGCHLD, signal.SIGCONT, signal.SIGURG, signal.SIGWINCH),  # do nothing of themselves
    *(
        signal.SIGSEGV,
        signal.SIGBUS,
        signal.SIGFPE,
        signal.SIGILL,
        signal.SIGTRAP,
        signal.SIGSYS,
    ),  # it is broken
}

ENDING: tuple[int, ...] = tuple(sorted(signal.valid_signals() - _OTHERS))
"""All catchable signals that end or suspend a process that does not handle them."""


@contextmanager
def held_back() -> Generator[list[int]]:
    """Hold back signals that would end or interrupt the process while a block runs.

    They are delivered afterwards to their handlers. The block must end by itself.

    Yields:
        The signals received so far; those that the block removes are not delivered.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield came
        return

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)

    before = {n: signal.getsignal(n) for n in ENDING}
    taken = {n: handler for n, handler in before.items() if handler not in (None, signal.SIG_IGN)}
    for number in taken:
        signal.signal(number, note)
    try:
        yield came
    finally:
        for number, handler in taken.items():
            signal.signal(number, handler)
        for number in dict.fromkeys(came):
            signal.raise_signal(number)


def halt(stop: Callable[[], None], timeout_s: float, name: str, rig: str = "hand") -> str:
    """Calls a driver's ``stop``, a second time if it raises; it takes at most ``timeout_s`` and is not interrupted.

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
                trouble = f"stop() failed! {type(raised).__name__}: {raised}. {power}"
    return trouble
