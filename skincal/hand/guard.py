"""The guard between a hand and the program that moves it.

Every state is checked before it is returned, every command before it is sent. On any fault the driver's ``stop`` is
called, and an error says what happened. A command that breaks a limit is *refused* and stops the hand. It is not
clipped to what is allowed: the hand would then do something that nobody asked for, without the caller's knowledge. To
get the nearest allowed command, call :meth:`GuardedHand.nearest`.

Only if ``stop`` returned does the error say that the hand was stopped; otherwise it says to cut the power. Signals
that would end the process wait until that is known.

Times: from a bad state, a bad command or an exception to the call of ``stop`` a millisecond passes; for a call that
hangs, ``timeout_s``. Python cannot leave a driver that hangs in foreign code without releasing the interpreter lock.
"""

from __future__ import annotations

import atexit
import sys
import time
from collections.abc import Callable
from threading import Lock
from types import TracebackType
from typing import Any, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from skincal.hand.checks import ContactForce, StateCheck
from skincal.hand.commands import CommandCheck
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import ADVICE, HandError, HandErrorKind, Violation, again, described
from skincal.hand.halt import HURRY_S, STOPPED, halt, held_back
from skincal.hand.options import GuardOptions
from skincal.hand.worker import CallExitError, CallTimeoutError, Worker
from skincal.robot import HandDescription, check_limits

FloatArray = NDArray[np.float64]

LONGEST_PERIOD_S = 1.0
"""Longest period of a controlled hand [s]."""


class GuardedHand:
    """A hand that is safe to move: used like a driver, within a ``with`` block, for one connection.

    A separate thread of the guard makes all calls to the driver, except for ``stop``.

    Args:
        driver: the hand.
        options: limits and times.
        contact_force: the contact force of a state [N], from its joint angles and torques; None: not checked.
        clock: our clock [s].
    """

    def __init__(
        self,
        driver: HandDriver,
        options: GuardOptions | None = None,
        contact_force: ContactForce | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._driver = driver
        self._options = options or GuardOptions()
        self._contact_force = contact_force
        self._clock = clock
        self._worker: Worker | None = None
        self._lock = Lock()
        self._failure: HandError | None = None
        self._halted = False
        self._closed = False

    @property
    def name(self) -> str:
        """The driver's name."""
        return getattr(self._driver, "name", type(self._driver).__name__)

    @property
    def description(self) -> HandDescription:
        """The hand."""
        return self._driver.description

    @property
    def period_s(self) -> float:
        """Time between two states [s], on the hand's clock."""
        return self._driver.period_s

    @property
    def real_time(self) -> bool:
        """True if the hand's clock runs as fast as ours."""
        return self._driver.real_time

    @property
    def failure(self) -> HandError | None:
        """Error for which the guard stopped the hand; None without a fault."""
        return self._failure

    def connect(self) -> None:
        """Connect to the hand.

        Raises:
            InputError: the limits of its description are beyond those of any finger.
            HandError: it does not respond, or has been connected before.
        """
        if self._worker is not None:
            raise HandError(f"{self.name}: a guarded hand connects only once; create a new one", "order")
        options = self._options
        check_limits(self._driver.description, beyond=options.beyond_limits)
        self._worker = Worker(f"hand {self.name}", options.idle_s, self._idle)
        atexit.register(self._at_exit)
        try:
            self._call("connect", self._driver.connect, timeout_s=options.connect_timeout_s)
            period_s = self._driver.period_s
            if not 0 < period_s <= LONGEST_PERIOD_S:
                text = (
                    f"period_s: expected a time above 0 s, {LONGEST_PERIOD_S:g} s at most; got {period_s!r}"
                )
                self._fail("driver", text)
            self._check_state = StateCheck(self._driver, options, self._contact_force)
            self._check_command = CommandCheck(self._driver)
        except BaseException as error:
            # The exit of a `with` block that was not entered is not called.
            if isinstance(error, HandError) and error.stopped is not None:
                self._leave(error, "")
            else:
                self.__exit__(type(error), error, None)
            raise

    def observe(self) -> HandState:
        """Wait for the next state, check it and return it.

        Raises:
            HandError: a check failed; the hand has been stopped.
        """
        start_s = self._clock()
        state: HandState = self._call("observe", self._driver.observe, timeout_s=self._options.timeout_s)
        now_s = self._clock()
        violation = self._check_state(state, now_s, now_s - start_s)
        if violation is not None:
            self._violated(violation)
        self._check_command.observed(state, now_s)
        return state

    def act(self, command: HandCommand) -> None:
        """Check a command and send it.

        Raises:
            HandError: the command breaks a limit and was not sent, or the driver failed; the hand has been stopped.
        """
        self._ready("act")
        if self._halted:
            raise HandError(f"{self.name}: the hand has been stopped; connect again to move it", "stopped")
        violation = self._check_command(command, self._clock())
        if violation is not None:
            self._violated(violation)
        self._call("act", self._send, command, timeout_s=self._options.timeout_s)
        self._check_command.sent(command, self._clock())

    def nearest(self, q_desired_rad: FloatArray) -> HandCommand:
        """Return the allowed command nearest to some angles (n,) [rad], within joint limits and speed."""
        self._ready("nearest")
        return HandCommand(self._check_command.nearest(q_desired_rad, self._clock()))

    def stop(self) -> None:
        """Stop the hand; may be called at any time and from any thread. States can still be observed.

        Raises:
            HandError: the driver's ``stop`` raised, or did not return.
        """
        trouble = self._halt()
        if trouble:
            raise HandError(f"{self.name}: {trouble}", "driver", stopped=False)

    def close(self) -> None:
        """Release the hand. May be called twice.

        Raises:
            HandError: the driver's ``close`` raised, or did not return; the hand is stopped.
        """
        if self._closed or self._worker is None:
            return
        error = self._give_back(self._worker)
        if error is not None and self._failure is None:
            raise error

    def __enter__(self) -> Self:
        """Connect."""
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the hand, whatever happened, and release it. Add a note to the exception that the hand was stopped.

        Raises:
            HandError: the hand could not be stopped.
        """
        try:
            with held_back() as came:
                trouble = self._halt()
                if trouble or isinstance(error, KeyboardInterrupt):
                    try:
                        self._leave(error, trouble)
                    finally:
                        # The process is ending already, and the error must be reported.
                        came.clear()
                    return
        except KeyboardInterrupt as interrupt:
            if not self._closed:
                self._leave(interrupt, "")
            raise
        self._leave(error, trouble)

    def _leave(self, error: BaseException | None, trouble: str) -> None:
        """Release the hand, and report whether it was stopped."""
        told = isinstance(error, HandError) and error.stopped is False
        try:
            if not (trouble or told or isinstance(error, KeyboardInterrupt)):
                self.close()
            elif self._worker is not None and not self._closed:
                # Do not delay a user who must cut the power, or a process that is to end.
                self._give_back(self._worker, min(self._options.connect_timeout_s, HURRY_S))
        except HandError:
            # The exception of the block matters, not a failure to close after it.
            if error is None:
                raise
        except BaseException as interrupt:
            self._tell(interrupt, trouble)
            raise
        self._tell(error, trouble)

    def _tell(self, error: BaseException | None, trouble: str) -> None:
        """Note on the block's exception that the hand was stopped; raise an error if it was not."""
        if isinstance(error, HandError) and error.stopped is not None:
            return
        if trouble:
            reason = (
                "interrupted; "
                if isinstance(error, KeyboardInterrupt)
                else ""
                if error is None
                else f"{error}; "
            )
            raise HandError(f"{self.name}: {reason}{trouble}", "driver", stopped=False) from error
        if error is not None:
            error.add_note(STOPPED)

    def _at_exit(self) -> None:
        """Stop a hand that is still connected at the end of the process."""
        trouble = self._halt()
        if trouble:
            print(f"{self.name}: {trouble}", file=sys.stderr)

    def _ready(self, what: str) -> Worker:
        """Return the worker of a connected hand without faults."""
        if self._failure is not None:
            raise again(self._failure)
        if self._worker is None or self._closed:
            raise HandError(f"{self.name}: {what}() of a hand that is not connected", "order")
        return self._worker

    def _call(self, what: str, work: Callable[..., Any], *arguments: Any, timeout_s: float) -> Any:
        """Make a call to the driver; stop the hand on any fault."""
        worker = self._ready(what)
        try:
            return worker.call(self._unless_failed, work, arguments, timeout_s=timeout_s)
        except CallTimeoutError:
            text = f"{what}() did not return within {timeout_s:g} s"
            self._fail("timeout", text, value=timeout_s, limit=timeout_s)
        except Exception as error:
            if self._failure is not None:
                raise again(self._failure) from None
            raised = error.__cause__ if isinstance(error, CallExitError) else error
            kind, text = described(what, raised)
            own = error if isinstance(error, HandError) else HandError(text, kind)
            self._fail(kind, text, own.joint, own.value, own.limit, cause=raised)
        except BaseException:
            self._halt()
            raise

    def _unless_failed(self, work: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Run in the worker: do nothing if the hand was stopped while the call waited for its turn."""
        if self._failure is not None:
            raise self._failure
        return work(*arguments)

    def _send(self, command: HandCommand) -> None:
        """Run in the worker: send nothing if the hand was stopped while the command waited for its turn."""
        if self._halted:
            raise HandError("the hand has been stopped; the command was not sent", "stopped")
        self._driver.act(command)

    def _violated(self, violation: Violation) -> NoReturn:
        self._fail(violation.kind, violation.text, violation.joint, violation.value, violation.limit)

    def _fail(
        self,
        kind: HandErrorKind,
        text: str,
        joint: str | None = None,
        value: float | None = None,
        limit: float | None = None,
        cause: BaseException | None = None,
    ) -> NoReturn:
        """Stop the hand and raise the error; only the first failure counts."""
        trouble = self._halt()
        end = trouble or f"The hand was stopped. {ADVICE[kind]}"
        error = HandError(
            f"{self.name}: {text}. {end}", kind, joint=joint, value=value, limit=limit, stopped=not trouble
        )
        with self._lock:
            self._failure = self._failure or error
        raise error from cause

    def _halt(self) -> str:
        """Stop the hand; return the failure to do so, or ''."""
        self._halted = True
        return halt(self._driver.stop, self._options.stop_timeout_s, self.name)

    def _idle(self) -> None:
        """Run in the worker: stop a hand that has not been called for ``idle_s``."""
        if self._closed or self._halted:
            return
        try:
            self._fail("idle", f"no call for {self._options.idle_s:g} s", limit=self._options.idle_s)
        except HandError:
            # The next call raises the error.
            return

    def _give_back(self, worker: Worker, timeout_s: float | None = None) -> HandError | None:
        """Close the driver and let the worker end; return the error of closing, or None."""
        self._closed = True
        atexit.unregister(self._at_exit)
        options = self._options
        timeout_s = timeout_s or options.connect_timeout_s
        hung = self._failure is not None and self._failure.kind == "timeout"
        try:
            # A driver with a hanging call cannot be closed; do not wait.
            worker.call(lambda: None, timeout_s=options.stop_timeout_s if hung else options.timeout_s)
            worker.call(self._driver.close, timeout_s=timeout_s)
        except CallTimeoutError:
            return HandError(f"{self.name}: close() did not return within {timeout_s:g} s", "timeout")
        except Exception as error:
            raised = error.__cause__ if isinstance(error, CallExitError) else error
            return HandError(f"{self.name}: {described('close', raised)[1]}", "driver")
        finally:
            worker.end()
        return None
