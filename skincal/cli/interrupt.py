"""Ctrl-C that comes while modules are being loaded waits until they are."""

from __future__ import annotations

import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType

AGAIN_S = 0.02
"""How soon it is looked again whether the modules are loaded [s]."""


@contextmanager
def after_imports() -> Generator[None]:
    """Holds an interrupt back while an import is going on.

    An extension module that is interrupted in the middle may swallow the interrupt, so that the work goes on, or
    fail with an error of its own. Where SIGINT is ignored or handled by somebody else, nothing is changed.
    """
    handled = threading.current_thread() is threading.main_thread()
    if not handled or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    timer = signal.signal(signal.SIGALRM, _interrupt)
    signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGINT, signal.default_int_handler)
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
