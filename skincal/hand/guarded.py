"""The guard between a rig and the program that moves it: calls that return in time, and a true stop.

Every state is checked before it is returned, every command before it is sent. On any fault the driver's ``stop`` is
called, and an error says what happened. A command that breaks a limit is *refused* and stops the rig. It is not
clipped to what is allowed: the rig would then do something that nobody asked for, without the caller's knowledge.

Only if ``stop`` returned does the error say that the rig was stopped; otherwise it says to cut its power. Signals
that would end the process wait until that is known.

Times: from a bad state, a bad command or an exception to the call of ``stop`` a millisecond passes; from a call that
hangs, ``timeout_s``. Python cannot leave a driver that hangs in foreign code without releasing the interpreter lock.
"""

from __future__ import annotations

import atexit
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from threading import Lock
from types import TracebackType
from typing import Any, ClassVar, Generic, NoReturn, Self, TypeVar

from skincal.hand.driver import HandDriver
from skincal.hand.errors import ADVICE, HandError, HandErrorKind, Violation, again, described
from skincal.hand.halt import HURRY_S, halt, held_back, stopped
from skincal.hand.options import GuardOptions
from skincal.hand.stage import StageDriver
from skincal.hand.worker import CallExitError, CallTimeoutError, Worker

LONGEST_PERIOD_S = 1.0
"""A rig that is commanded less often than this is not controlled [s]."""


PATIENCE = 10.0
"""A simulated rig may take so many times longer to connect; compiling takes a quarter of a minute on an idle core."""

State = TypeVar("State")
Command = TypeVar("Command")


class Guarded(ABC, Generic[State, Command]):
    """A rig that is safe to move: used as a driver is, within a ``with`` block, for one connection.

    Calls to the driver are made by one thread of the guard's own, except for ``stop``.

    Args:
        driver: the rig.
        options: limits and times.
        clock: our clock [s].
    """

    rig: ClassVar[str]
    """What it is called in errors."""

    def __init__(
        self,
        driver: HandDriver | StageDriver,
        options: GuardOptions | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._made: Any = driver
        self._options = options or GuardOptions()
        self._clock = clock
        self._worker: Worker | None = None
        self._lock = Lock()
        self._failure: HandError | None = None
        self._halted = False
        self._closed = False

    @abstractmethod
    def _check_limits(self) -> None:
        """Refuses a description beyond all bounds, before connecting.

        Raises:
            InputError: it is.
        """

    @abstractmethod
    def _checks(self) -> tuple[Any, Any]:
        """What looks at states and at commands, once the rig is connected (:mod:`skincal.hand.checks`)."""

    @property
    def name(self) -> str:
        """The driver's name."""
        return getattr(self._made, "name", type(self._made).__name__)

    @property
    def period_s(self) -> float:
        """Time between two states [s], on the rig's clock."""
        return self._made.period_s

    @property
    def real_time(self) -> bool:
        """Whether the rig's clock runs as fast as ours."""
        return self._made.real_time

    @property
    def failure(self) -> HandError | None:
        """Why the rig was stopped by the guard; None while all is well."""
        return self._failure

    def connect(self) -> None:
        """Takes the rig.

        Raises:
            InputError: the limits of its description are beyond all bounds.
            HandError: it does not answer, or has been connected before.
        """
        if self._worker is not None:
            raise HandError(f"{self.name}: a guarded {self.rig} connects only once; create a new one", "order")
        options = self._options
        self._check_limits()
        self._worker = Worker(f"{self.rig} {self.name}", options.idle_s, self._idle)
        atexit.register(self._at_exit)
        # What a simulated rig computes first (it may compile its skin model) takes longer where others are at work.
        patience = 1.0 if self._made.real_time else PATIENCE
        try:
            self._call("connect", self._made.connect, timeout_s=patience * options.connect_timeout_s)
            period_s = self._made.period_s
            if not 0 < period_s <= LONGEST_PERIOD_S:
                text = (
                    f"period_s: expected a time above 0 s, {LONGEST_PERIOD_S:g} s at most; got {period_s!r}"
                )
                self._fail("driver", text)
            self._check_state, self._check_command = self._checks()
        except BaseException as error:
            # A `with` block that was not entered does not leave.
            if isinstance(error, HandError) and error.stopped is not None:
                self._leave(error, "")
            else:
                self.__exit__(type(error), error, None)
            raise

    def observe(self) -> State:
        """Waits for the next state, checks it and returns it.

        Raises:
            HandError: something is wrong; the rig has been stopped.
        """
        start_s = self._clock()
        state: State = self._call("observe", self._made.observe, timeout_s=self._options.timeout_s)
        now_s = self._clock()
        violation = self._check_state(state, now_s, now_s - start_s)
        if violation is not None:
            self._violated(violation)
        self._check_command.observed(state, now_s)
        return state

    def act(self, command: Command) -> None:
        """Checks a command and sends it.

        Raises:
            HandError: the command breaks a limit and was not sent, or the driver failed; the rig has been stopped.
        """
        self._ready("act")
        if self._halted:
            raise HandError(
                f"{self.name}: the {self.rig} has been stopped; connect anew to move it", "stopped"
            )
        violation = self._check_command(command, self._clock())
        if violation is not None:
            self._violated(violation)
        self._call("act", self._send, command, timeout_s=self._options.timeout_s)
        self._check_command.sent(command, self._clock())

    def stop(self) -> None:
        """Stops the rig; may be called at any time and from any thread. States can still be observed.

        Raises:
            HandError: the driver's ``stop`` raised, or did not return.
        """
        trouble = self._halt()
        if trouble:
            raise HandError(f"{self.name}: {trouble}", "driver", stopped=False)

    def close(self) -> None:
        """Gives the rig back. May be called twice.

        Raises:
            HandError: the driver's ``close`` raised, or did not return; the rig is stopped.
        """
        if self._closed or self._worker is None:
            return
        error = self._give_back(self._worker)
        if error is not None and self._failure is None:
            raise error

    def __enter__(self) -> Self:
        """Connects."""
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stops the rig, whatever happened, and gives it back. What ended the block has a note that it was stopped.

        Raises:
            HandError: it could not be stopped.
        """
        try:
            with held_back() as came:
                trouble = self._halt()
                if trouble or isinstance(error, KeyboardInterrupt):
                    try:
                        self._leave(error, trouble)
                    finally:
                        # It ends already, and what there is to say must be said.
                        came.clear()
                    return
        except KeyboardInterrupt as interrupt:
            if not self._closed:
                self._leave(interrupt, "")
            raise
        self._leave(error, trouble)

    def _leave(self, error: BaseException | None, trouble: str) -> None:
        """Gives the rig back, and tells whether it was stopped."""
        told = isinstance(error, HandError) and error.stopped is False
        try:
            if not (trouble or told or isinstance(error, KeyboardInterrupt)):
                self.close()
            elif self._worker is not None and not self._closed:
                # Whoever has to cut the power, or wants an end, is not kept waiting.
                self._give_back(self._worker, min(self._options.connect_timeout_s, HURRY_S))
        except HandError:
            # What ended the block is the news, not that closing failed after it.
            if error is None:
                raise
        except BaseException as interrupt:
            self._tell(interrupt, trouble)
            raise
        self._tell(error, trouble)

    def _tell(self, error: BaseException | None, trouble: str) -> None:
        """Notes at what ends the block that the rig was stopped; where it was not, that is what ends it."""
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
            error.add_note(stopped(self.rig))

    def _at_exit(self) -> None:
        """At the end of a process that forgot its rig."""
        trouble = self._halt()
        if trouble:
            print(f"{self.name}: {trouble}", file=sys.stderr)

    def _ready(self, what: str) -> Worker:
        """The worker, where the rig is connected and nothing has gone wrong."""
        if self._failure is not None:
            raise again(self._failure)
        if self._worker is None or self._closed:
            raise HandError(f"{self.name}: {what}() of a {self.rig} that is not connected", "order")
        return self._worker

    def _call(self, what: str, work: Callable[..., Any], *arguments: Any, timeout_s: float) -> Any:
        """Makes a call to the driver; whatever goes wrong, the rig is stopped."""
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
        """In the worker: nothing is sent after the rig was stopped while the call waited for its turn."""
        if self._failure is not None:
            raise self._failure
        return work(*arguments)

    def _send(self, command: Command) -> None:
        """In the worker: nothing is sent after the rig was stopped while the command waited for its turn."""
        if self._halted:
            raise HandError(f"the {self.rig} has been stopped; the command was not sent", "stopped")
        self._made.act(command)

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
        """Stops the rig, and raises what happened; the first failure is the one that counts."""
        trouble = self._halt()
        end = trouble or f"{stopped(self.rig)} {self._advice(kind)}".rstrip()
        error = HandError(
            f"{self.name}: {text}. {end}", kind, joint=joint, value=value, limit=limit, stopped=not trouble
        )
        with self._lock:
            self._failure = self._failure or error
        raise error from cause

    def _halt(self) -> str:
        """Stops the rig. Returns what went wrong with that; empty: it was stopped."""
        self._halted = True
        return halt(self._made.stop, self._options.stop_timeout_s, self.name, self.rig)

    def _advice(self, kind: HandErrorKind) -> str:
        return ADVICE[kind]

    def _idle(self) -> None:
        """In the worker: nobody has called for ``idle_s``."""
        if self._closed or self._halted:
            return
        try:
            self._fail("idle", f"no call for {self._options.idle_s:g} s", limit=self._options.idle_s)
        except HandError:
            # The next call raises it.
            return

    def _give_back(self, worker: Worker, timeout_s: float | None = None) -> HandError | None:
        """Closes the driver and lets the worker end. Returns what went wrong."""
        self._closed = True
        atexit.unregister(self._at_exit)
        options = self._options
        timeout_s = timeout_s or options.connect_timeout_s
        hung = self._failure is not None and self._failure.kind == "timeout"
        try:
            # Behind a call that hangs there is no closing, and nothing to wait for.
            worker.call(lambda: None, timeout_s=options.stop_timeout_s if hung else options.timeout_s)
            worker.call(self._made.close, timeout_s=timeout_s)
        except CallTimeoutError:
            return HandError(f"{self.name}: close() did not return within {timeout_s:g} s", "timeout")
        except Exception as error:
            raised = error.__cause__ if isinstance(error, CallExitError) else error
            return HandError(f"{self.name}: {described('close', raised)[1]}", "driver")
        finally:
            worker.end()
        return None
