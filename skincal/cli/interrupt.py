"""Interrupts: end a command early on Ctrl-C, on a signal (``kill``, a scheduler), or when its terminal goes away."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING

from skincal.cli.terminal import say
from skincal.errors import InputError, SkincalError, text_of
from skincal.signals import ENDING, restore

if TYPE_CHECKING:
    from skincal.hand.calls import Stop

TOGETHER_S = 0.5
"""Signals that come within this time are one request: a second interrupt would cut off what the first one began [s]."""

MOVING_TOGETHER_S = 10.0
"""The same while a verb moves a rig, whose end takes longer [s]."""

AGAIN_S = 0.02
"""Interval at which a held-back interrupt checks whether the modules have loaded [s]."""


REQUESTS = (signal.SIGTERM, signal.SIGHUP)
"""Signals besides Ctrl-C that ask a command to end. Unhandled, they kill the process with a finger on the skin."""


class Ended(SystemExit):
    """The end of a verb that has said why; any other ``SystemExit`` is that of a driver or a library."""


def is_interrupt(error: BaseException) -> bool:
    """Return whether an error is a request to end, or what a library made of one: numpy has other errors instead."""
    asked = _asked_s[0] > -math.inf and not isinstance(
        error, (SkincalError, OSError, MemoryError, SystemExit)
    )
    return isinstance(error, KeyboardInterrupt) or asked


AGAIN = "give the same command again to continue"


@contextmanager
def resumable(saved: Callable[[], str], nothing: str = "Nothing was saved.") -> Generator[None]:
    """Say, when a verb ends early, what is saved of its work and how to continue, or ``nothing`` at an interrupt."""
    try:
        yield
    except BaseException as error:
        stopped = is_interrupt(error)
        text = saved() or nothing * stopped
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
    The first signal stops every connected rig before it interrupts, so that nothing depends on where it interrupts.

    Args:
        saved: saves what is left to save of the work of a verb that ends early, while signals wait, and returns what
            is saved.
    """
    from skincal.hand.calls import stops_noted

    # `interruptible` uses the alarm to check again.
    more = (number for number in ENDING if number != signal.SIGALRM)
    with (
        stops_noted() as stops,
        _stopping_first(stops),
        interruptible(*more, ignored=(signal.SIGINT, signal.SIGQUIT)),
    ):
        reported: list[int] = []
        # Twice: an interrupt of the inner one before it has reported reaches the outer one.
        with _reporting_end(saved, stops, reported), _reporting_end(saved, stops, reported):
            yield


@contextmanager
def _reporting_end(
    saved: Callable[[], str], stops: Mapping[tuple[str, str], Stop], reported: list[int]
) -> Generator[None]:
    """Report the end of a verb that moves a rig, once; ``reported`` receives the exit status."""
    try:
        yield
    except (KeyboardInterrupt, Exception) as error:  # a full disk, no memory left, a fault of ours
        if isinstance(error, InputError) and not stops:
            raise  # found before the rig moved
        while not reported:
            with suppress(KeyboardInterrupt):  # of a further signal
                reported.append(_report_end(error, saved, [*stops.values()]))
        if not reported[0]:
            raise
        raise Ended(reported[0]) from None


def _report_end(error: BaseException, saved: Callable[[], str], stops: Sequence[Stop]) -> int:
    """Say why a verb that moves a rig ends, what is saved, and whether the rig was stopped.

    Returns:
        The exit status; 0: the error says the rest, and is to be reported as any other.
    """
    # The command ends now; further signals must not suppress the message.
    for number in ENDING:
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, signal.SIG_IGN)
    danger = _danger(error, stops)
    stopped = is_interrupt(error)
    if danger:  # at once: saving may take a while
        say(f"skincal: error: {danger}")
    try:
        kept = saved()
    except Exception as trouble:
        kept = f"The work so far could not be saved: {text_of(trouble)}"
    statements = [] if danger else [*dict.fromkeys(f"The {stop.rig} was stopped." for stop in stops)]
    text = " ".join(filter(None, [*statements, kept]))
    if stopped and not danger:
        say(f"skincal: interrupted. {text}".rstrip())
    elif text:
        say(f"skincal: the session ended early. {text}")
    return 1 if danger else 130 if stopped else 0


def _danger(error: BaseException | None, stops: Sequence[Stop]) -> str:
    """Stop the rigs that were not; return the warning that one could not be, or ''."""
    troubles = [f"{stop.name}: {text}" for stop in stops if (text := _stopped(stop))]
    while error is not None:
        if getattr(error, "stopped", None) is False:
            return text_of(error, 2000)
        error = error.__cause__ or error.__context__
    return " ".join(troubles)


def _stopped(stop: Stop) -> str:
    return stop() if stop.trouble is None else stop.trouble


@contextmanager
def _stopping_first(stops: Mapping[tuple[str, str], Stop]) -> Generator[None]:
    """Have a request to end stop the rigs before it interrupts."""

    def stop_all() -> None:
        for stop in [*stops.values()]:
            _stopped(stop)

    before = _first[0], _together_s[0]
    _first[0], _together_s[0] = stop_all, MOVING_TOGETHER_S
    try:
        yield
    finally:
        _first[0], _together_s[0] = before


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
        restore({**before, signal.SIGALRM: timer})


def _interrupt(number: int, frame: FrameType | None) -> None:
    if _at_work:
        return
    _at_work.append(number)
    try:
        _first[0]()
    finally:
        _at_work.clear()
    if _importing(frame):
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        return
    now_s = time.monotonic()
    if now_s - _asked_s[0] > _together_s[0]:
        _asked_s[0] = now_s
        raise KeyboardInterrupt


_first: list[Callable[[], None]] = [lambda: None]
"""What a request does before it interrupts; not interrupted itself."""

_at_work: list[int] = []
"""The signal whose handler does that; another one meanwhile is the same request."""

_together_s = [TOGETHER_S]
"""Time within which signals are one request [s]."""

_asked_s = [-math.inf]
"""When a signal interrupted last [s]."""


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
