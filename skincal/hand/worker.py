"""A worker thread for calls that may hang, so that the caller can abandon them."""

from __future__ import annotations

import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any

from skincal.errors import quoted

SLICE_S = 0.02
"""Length of a single wait [s]: a Ctrl-C just before a wait does not end it, but the next one can."""


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
        self._jobs: SimpleQueue[tuple[int, Callable[..., Any], tuple[Any, ...]] | None] = SimpleQueue()
        self._results: SimpleQueue[tuple[int, Any, BaseException | None]] = SimpleQueue()
        self._ticket = 0
        self._idle_s = idle_s
        self._on_idle = on_idle
        self._thread = Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def call(self, work: Callable[..., Any], *arguments: Any, timeout_s: float) -> Any:
        """Make a call, and wait for it.

        Raises:
            CallTimeoutError: the call did not return within ``timeout_s``.
            CallExitError: the call raised anything but an ``Exception``.
            Exception: what the call raised.
        """
        self._ticket += 1
        ticket = self._ticket
        self._jobs.put((ticket, work, arguments))
        deadline = time.monotonic() + timeout_s
        while True:
            left = deadline - time.monotonic()
            try:
                done, value, error = self._results.get(timeout=min(max(left, 0.0), SLICE_S))
            except Empty:
                if left <= SLICE_S:
                    raise CallTimeoutError from None
                continue
            if done == ticket:
                break
            # The answer to an earlier call, which was abandoned.
        _raise(error)
        return value

    def end(self, wait_s: float = 0.0) -> None:
        """Let the thread end after its pending calls; wait for that at most ``wait_s``."""
        self._jobs.put(None)
        if wait_s > 0.0:
            self._thread.join(wait_s)

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
            ticket, work, arguments = job
            try:
                self._results.put((ticket, work(*arguments), None))
            except BaseException as error:
                quoted(error)  # a text that hangs hangs here, where the caller does not wait for it
                self._results.put((ticket, None, error))


def call_and_leave(work: Callable[[], Any], timeout_s: float, name: str) -> None:
    """Make one call in a separate thread, and abandon it if it does not return in time.

    Raises:
        CallTimeoutError: the call did not return within ``timeout_s``.
        CallExitError: the call raised anything but an ``Exception``.
        Exception: what the call raised.
    """
    done: SimpleQueue[BaseException | None] = SimpleQueue()

    def run() -> None:
        try:
            work()
            done.put(None)
        except BaseException as error:
            quoted(error)  # as above
            done.put(error)

    try:
        Thread(target=run, name=name, daemon=True).start()
    except RuntimeError:
        # The interpreter is shutting down, or there are no threads left: a call that may hang is better than none.
        run()
    try:
        error = done.get(timeout=timeout_s)
    except Empty:
        raise CallTimeoutError from None
    _raise(error)


def _raise(error: BaseException | None) -> None:
    if isinstance(error, Exception):
        raise error
    if error is not None:
        raise CallExitError(quoted(error)) from error
