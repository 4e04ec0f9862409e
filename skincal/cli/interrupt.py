"""What ends a command early: Ctrl-C, a request to end (``kill``, a scheduler), a terminal that goes away."""

from __future__ import annotations

import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType

AGAIN_S = 0.02
"""How soon it is looked again whether the modules are loaded [s]."""

REQUESTS = (signal.SIGTERM, signal.SIGHUP)
"""What else asks a command to end. Left to themselves they end the process where it stands, a finger on the skin."""


@contextmanager
def interruptible() -> Generator[None]:
    """Turns every request to end into a ``KeyboardInterrupt``, and holds it back while an import is going on.

    So a verb stops its hand, says what is kept and removes what is half-written, whoever asks. An extension module that
    is interrupted in the middle of its import may swallow the interrupt, so that the work goes on, or fail with an
    error of its own. A signal that is ignored (``nohup``) or handled by somebody else stays so.
    """
    ours = {signal.SIGINT: signal.default_int_handler} | dict.fromkeys(REQUESTS, signal.SIG_DFL)
    before = {number: own for number, own in ours.items() if signal.getsignal(number) is own}
    if threading.current_thread() is not threading.main_thread() or not before:
        yield
        return
    timer = signal.signal(signal.SIGALRM, _interrupt)
    for number in before:
        signal.signal(number, _interrupt)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.signal(signal.SIGALRM, timer)


def _interrupt(number: int, frame: FrameType | None) -> None:
    if _importing(frame):
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        return
    raise KeyboardInterrupt


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
