"""Signals that end a process: held back while something must not be cut short."""

from __future__ import annotations

import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType
from typing import Any

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
    try:
        for number in taken:
            signal.signal(number, note)
        yield came
    finally:
        restore(taken)
        for number in dict.fromkeys(came):
            signal.raise_signal(number)


def restore(handlers: dict[int, Any]) -> None:
    """Give every signal its handler back; a handler that raises meanwhile does so after the last one."""
    raised = None
    while handlers:
        try:
            while handlers:
                number = next(iter(handlers))
                signal.signal(number, handlers[number])
                del handlers[number]
        except BaseException as error:
            raised = error
    if raised is not None:
        raise raised
