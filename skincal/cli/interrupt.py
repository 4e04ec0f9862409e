"""What ends a command early: Ctrl-C, a request to end (``kill``, a scheduler), a terminal that goes away."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from types import FrameType

from skincal.cli.common import say

AGAIN_S = 0.02
"""How soon it is looked again whether the modules are loaded [s]."""

REQUESTS = (signal.SIGTERM, signal.SIGHUP)
"""What else asks a command to end. Left to themselves they end the process where it stands, a finger on the skin."""


@contextmanager
def moving(kept: Callable[[], str] = lambda: "") -> Generator[None]:
    """Lets no signal end or suspend a verb that moves a hand before the hand has been stopped.

    Whatever can be caught interrupts: Ctrl-Z too, as a hand that nobody watches must not go on pressing.

    Args:
        kept: what is left of the work, to be said at the end of an interrupted verb.
    """
    from skincal.hand.errors import HandError
    from skincal.hand.halt import ENDING

    # The alarm is what `interruptible` looks again with.
    with interruptible(*(number for number in ENDING if number != signal.SIGALRM)):
        try:
            yield
        except (KeyboardInterrupt, HandError) as error:
            danger, notes = _said(error)
            if isinstance(error, HandError) and not danger:
                raise
            # The command ends now; whoever asks again must not keep it from saying this.
            for number in ENDING:
                if signal.getsignal(number) is _interrupt:
                    signal.signal(number, signal.SIG_IGN)
            if danger:
                say(f"skincal: error: {danger}")
                raise SystemExit(1) from None
            say(" ".join(filter(None, ["skincal: interrupted.", *notes, kept()])))
            raise SystemExit(130) from None


def _said(error: BaseException | None) -> tuple[str, list[str]]:
    """What is said of a hand that was not stopped, if any, and the notes of what ended a verb and what came before."""
    danger, notes = "", list[str]()
    while error is not None:
        if getattr(error, "stopped", None) is False:
            danger = danger or str(error)
        notes += [note for note in getattr(error, "__notes__", []) if note not in notes]
        error = error.__cause__ or error.__context__
    return danger, notes


@contextmanager
def interruptible(*more: int) -> Generator[None]:
    """Turns every request to end into a ``KeyboardInterrupt``, and holds it back while an import is going on.

    So a verb stops its hand, says what is kept and removes what is half-written, whoever asks. An extension module that
    is interrupted in the middle of its import may swallow the interrupt, so that the work goes on, or fail with an
    error of its own. A signal that is ignored (``nohup``) or handled by somebody else stays so.

    Args:
        more: other signals that interrupt.
    """
    ours = {signal.SIGINT: signal.default_int_handler} | dict.fromkeys((*REQUESTS, *more), signal.SIG_DFL)
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
