"""Calls that may hang: a thread that makes them, so that whoever waits can leave."""

from __future__ import annotations

import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any

SLICE_S = 0.02
"""A Ctrl-C that comes just before a wait begins does not end it; waits of this length do [s]."""


class CallTimeoutError(Exception):
    """A call did not come back in time; it may still be going on."""


class CallExitError(Exception):
    """A call raised what is to end the process (``SystemExit``, ``KeyboardInterrupt``), which is its cause.

    So that a driver that raises it is told from a person who presses Ctrl-C.
    """


class Worker:
    """One daemon thread that makes all calls to a driver, in order.

    A call that hangs is left behind: the thread waits in it, and dies with the process.

    Args:
        name: name of the thread.
        idle_s: after so long without a call ``on_idle`` is called, in the thread, once [s]; None: never.
        on_idle: what to do then.
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
        """Make a call, and waits for it.

        Raises:
            CallTimeoutError: it did not return within ``timeout_s``.
            CallExitError: the call raised what is no ``Exception``.
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
            # The answer of an earlier call, which was left.
        _raise(error)
        return value

    def end(self, wait_s: float = 0.0) -> None:
        """Let the thread end after the calls that it has; waits for that at most ``wait_s``."""
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
                self._results.put((ticket, None, error))


def call_and_leave(work: Callable[[], Any], timeout_s: float, name: str) -> None:
    """Make one call in a thread of its own, and leaves it if it does not return in time.

    Raises:
        CallTimeoutError: it did not return within ``timeout_s``.
        CallExitError: the call raised what is no ``Exception``.
        Exception: what the call raised.
    """
    done: SimpleQueue[BaseException | None] = SimpleQueue()

    def run() -> None:
        try:
            work()
            done.put(None)
        except BaseException as error:
            done.put(error)

    try:
        Thread(target=run, name=name, daemon=True).start()
    except RuntimeError:
        # The interpreter is shutting down, or there are no threads left: better a call that may hang than none.
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
        raise CallExitError(f"{type(error).__name__}: {error}") from error
