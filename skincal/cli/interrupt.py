"""Interrupts: end a command early on Ctrl-C, on a signal (``kill``, a scheduler), or when its terminal goes away."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Collection, Generator
from contextlib import contextmanager, suppress
from types import FrameType

from skincal.cli.terminal import say
from skincal.errors import InputError, text_of
from skincal.signals import ENDING

TOGETHER_S = 0.05
"""Signals that come within this time are one request: a second interrupt would cut off what the first one began [s]."""

AGAIN_S = 0.02
"""Interval at which a held-back interrupt checks whether the modules have loaded [s]."""


REQUESTS = (signal.SIGTERM, signal.SIGHUP)
"""Signals besides Ctrl-C that ask a command to end. Unhandled, they kill the process with a finger on the skin."""


class Ended(SystemExit):
    """The end of a verb that has said why; any other ``SystemExit`` is that of a driver or a library."""


AGAIN = "give the same command again to continue"


@contextmanager
def resumable(saved: Callable[[], str]) -> Generator[None]:
    """Say, when a verb ends early, what is saved of its work and how to continue."""
    try:
        yield
    except BaseException as error:
        text, stopped = saved(), isinstance(error, KeyboardInterrupt)
        if not text:
            raise
        say(f"skincal: {'interrupted' if stopped else 'the work ended early'}. {text}")
        if stopped:
            raise Ended(130) from None
        raise


@contextmanager
def moving(saved: Callable[[], str] = lambda: "") -> Generator[None]:
    """Keep signals from ending or suspending a verb that moves a hand before the hand has been stopped.

    Every signal that can be caught interrupts, Ctrl-Z too: a hand that nobody watches must not go on pressing. So do
    SIGINT and SIGQUIT of a verb in the background of a script, where the shell ignores them: Ctrl-C ends the script.

    Args:
        saved: saves what is left to save of the work of a verb that ends early, while signals wait, and returns what
            is saved.
    """
    # `interruptible` uses the alarm to check again.
    more = (number for number in ENDING if number != signal.SIGALRM)
    with interruptible(*more, ignored=(signal.SIGINT, signal.SIGQUIT)):
        try:
            yield
        except (KeyboardInterrupt, Exception) as error:  # a full disk, no memory left, a fault of ours
            if isinstance(error, InputError) and not hasattr(error, "__notes__"):
                raise  # found before the hand moved
            status = None
            while status is None:
                with suppress(KeyboardInterrupt):  # of a further signal
                    status = _tell_end(error, saved)
            if not status:
                raise
            raise Ended(status) from None


def _tell_end(error: BaseException, saved: Callable[[], str]) -> int:
    """Say why a verb that moves a hand ends, what is saved, and whether the hand was stopped.

    Returns:
        The exit status; 0: the error says the rest, and is to be reported as any other.
    """
    # The command ends now; further signals must not suppress the message.
    for number in ENDING:
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, signal.SIG_IGN)
    danger, notes = _danger_and_notes(error)
    stopped = isinstance(error, KeyboardInterrupt)
    if danger:  # at once: saving may take a while
        say(f"skincal: error: {danger}")
    try:
        kept = saved()
    except Exception as trouble:
        kept = f"The work so far could not be saved: {text_of(trouble)}"
    text = " ".join(filter(None, [*([] if danger else notes), kept]))
    if stopped and not danger:
        say(f"skincal: interrupted. {text}".rstrip())
    elif text:
        say(f"skincal: the session ended early. {text}")
    return 1 if danger else 130 if stopped else 0


def _danger_and_notes(error: BaseException | None) -> tuple[str, list[str]]:
    """Return the warning that a hand was not stopped, or '', and the notes of an exception and its causes."""
    danger, notes = "", list[str]()
    while error is not None:
        if getattr(error, "stopped", None) is False:
            danger = danger or text_of(error, 2000)
        notes += getattr(error, "__notes__", [])
        error = error.__cause__ or error.__context__
    return danger, [*dict.fromkeys(notes)]


@contextmanager
def interruptible(*more: int, ignored: Collection[int] = ()) -> Generator[None]:
    """Turn every request to end into a ``KeyboardInterrupt``, held back while an import is running.

    So a verb stops its hand, says what is saved and removes half-written files, whoever asks. An extension module that
    is interrupted during its import may swallow the interrupt, so that the work goes on, or fail with an error of its
    own. A signal that is ignored (``nohup``) or handled elsewhere is left alone.
    """
    ours = dict.fromkeys((*REQUESTS, *more), signal.SIG_DFL) | {signal.SIGINT: signal.default_int_handler}
    now = {number: signal.getsignal(number) for number in ours}
    before = {
        number: handler
        for number, handler in now.items()
        if handler is ours[number] or (handler is signal.SIG_IGN and number in ignored)
    }
    if threading.current_thread() is not threading.main_thread() or not before:
        yield
        return
    _asked_s[0] = -math.inf
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
    last_s, _asked_s[0] = _asked_s[0], time.monotonic()
    if _asked_s[0] - last_s > TOGETHER_S:
        raise KeyboardInterrupt


_asked_s = [-math.inf]
"""When a signal came last [s]."""


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
