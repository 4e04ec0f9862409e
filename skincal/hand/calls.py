"""Calls of a driver that may hang: a worker thread, calls that are abandoned, and the stop of a rig."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, TypeVar

from skincal.errors import quoted
from skincal.signals import held_back

SLICE_S = 0.02
"""Length of a single wait [s]: a Ctrl-C just before a wait does not end it, but the next one can."""


Job = tuple[int, Callable[..., Any], tuple[Any, ...]]
"""Number of a call, the call and its arguments."""

Result = tuple[int, Any, BaseException | None]
"""Number of a call, what it returned, and what it raised."""

Value = TypeVar("Value")


class CallTimeoutError(Exception):
    """A call that did not return in time; it may still be running."""


class CallExitError(Exception):
    """A call that raised an exception to end the process (``SystemExit``, ``KeyboardInterrupt``), which is its cause.

    This distinguishes a driver that raises it from a user who presses Ctrl-C.
    """


class Worker:
    """A daemon thread that makes all calls to a driver, in order.

    A call that hangs is abandoned: the thread waits in it, and ends with the process.

    Args:
        idle_s: time without a call after which ``on_idle`` is called once in the thread [s]; None: never.
    """

    def __init__(
        self, name: str, idle_s: float | None = None, on_idle: Callable[[], None] | None = None
    ) -> None:
        self._jobs: SimpleQueue[Job | None] = SimpleQueue()
        self._results: SimpleQueue[Result] = SimpleQueue()
        self._ticket = 0
        self._idle_s = idle_s
        self._on_idle = on_idle
        Thread(target=self._work, name=name, daemon=True).start()

    def call(self, work: Callable[..., Any], *arguments: Any, timeout_s: float) -> Any:
        """Make a call, and wait for it; errors are those of :func:`call_and_leave`."""
        self._ticket += 1
        self._jobs.put((self._ticket, work, arguments))
        return _result(self._results, self._ticket, timeout_s)

    def end(self) -> None:
        """Let the thread end after its pending calls."""
        self._jobs.put(None)

    def _work(self) -> None:
        idle_s = self._idle_s
        while True:
            try:
                job = self._jobs.get(timeout=idle_s)
            except Empty:
                idle_s = None
                if self._on_idle is not None:
                    self._on_idle()
                continue
            if job is None:
                return
            _do(job, self._results)


def call_and_leave(work: Callable[[], Value], timeout_s: float, name: str) -> Value:
    """Make one call in a separate thread, and abandon it if it does not return in time.

    Raises:
        CallTimeoutError: the call did not return within ``timeout_s``.
        CallExitError: the call raised anything but an ``Exception``.
        Exception: what the call raised.
    """
    results: SimpleQueue[Result] = SimpleQueue()
    job: Job = (0, work, ())
    try:
        Thread(target=_do, args=(job, results), name=name, daemon=True).start()
    except RuntimeError:
        # The interpreter is shutting down, or there are no threads left: a call that may hang is better than none.
        _do(job, results)
    return _result(results, 0, timeout_s)


def raised_by(error: BaseException) -> BaseException:
    """Return what a driver raised, for an error of one of these calls."""
    return (error.__cause__ or error) if isinstance(error, CallExitError) else error


def _do(job: Job, results: SimpleQueue[Result]) -> None:
    ticket, work, arguments = job
    try:
        results.put((ticket, work(*arguments), None))
    except BaseException as error:
        quoted(error)  # a text that hangs hangs here, where the caller does not wait for it
        results.put((ticket, None, error))


def _result(results: SimpleQueue[Result], ticket: int, timeout_s: float) -> Any:
    """Wait for the result of a call; those of earlier calls, which were abandoned, are passed over."""
    deadline = time.monotonic() + timeout_s
    while True:
        left = deadline - time.monotonic()
        try:
            done, value, error = results.get(timeout=min(max(left, 0.0), SLICE_S))
        except Empty:
            if left <= SLICE_S:
                raise CallTimeoutError from None
            continue
        if done == ticket:
            break
    if isinstance(error, Exception):
        raise error
    if error is not None:
        raise CallExitError(quoted(error)) from error
    return value


def stopped(rig: str) -> str:
    """Return the statement that a rig was stopped, valid only after its ``stop`` returned."""
    return f"The {rig} was stopped."


STOPPED = stopped("hand")

HURRY_S = 2.0
"""Longest time for closing while somebody waits for the end [s]."""


class Stop:
    """The stop of a rig: what is said of the rig follows from this alone.

    Args:
        stop: the driver's ``stop``.
        timeout_s: longest time of a call [s].
        name: the driver's name.
        rig: the kind of rig.

    Attributes:
        asked: it was called: the rig is to move no more.
        trouble: what went wrong with the last call; empty: it returned, the rig is stopped; None: neither is known.
    """

    def __init__(self, stop: Callable[[], None], timeout_s: float, name: str, rig: str = "hand") -> None:
        self._stop, self._timeout_s, self.name, self.rig = stop, timeout_s, name, rig
        self.asked = False
        self.trouble: str | None = None

    def __call__(self) -> str:
        """Call the driver's ``stop``, a second time if it raises; this is not interrupted. Return the trouble."""
        self.asked = True
        trouble, power = "", f"Cut the {self.rig}'s power."
        with held_back():
            for _ in range(2):
                try:
                    call_and_leave(self._stop, self._timeout_s, f"stop {self.name}")
                    trouble = ""
                    break
                except CallTimeoutError:
                    trouble = f"stop() did not return within {self._timeout_s:g} s! {power}"
                    break
                except Exception as error:
                    trouble = f"stop() failed! {quoted(raised_by(error))}. {power}"
        self.trouble = trouble
        return trouble


_NOTED: list[dict[tuple[str, str], Stop]] = []


@contextmanager
def stops_noted() -> Generator[dict[tuple[str, str], Stop]]:
    """Yield the stops of the rigs that are connected during a block, by kind and name: the last one of each."""
    noted: dict[tuple[str, str], Stop] = {}
    _NOTED.append(noted)
    try:
        yield noted
    finally:
        _NOTED.remove(noted)


def note_stop(stop: Stop) -> None:
    """Note the stop of a rig that is about to be connected."""
    for noted in _NOTED:
        noted[stop.rig, stop.name] = stop
