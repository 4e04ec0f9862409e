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
import gc
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import suppress
from copy import copy
from dataclasses import fields, is_dataclass
from threading import Lock
from types import TracebackType
from typing import Any, ClassVar, Generic, NoReturn, Self, TypeVar

import numpy as np

from skincal.errors import one_line, quoted, shown, text_of
from skincal.hand.calls import HURRY_S, CallTimeoutError, Stop, Worker, note_stop, raised_by, stopped
from skincal.hand.driver import Command, Description, Driver, State
from skincal.hand.errors import ADVICE, HandError, HandErrorKind, described
from skincal.hand.guard_options import GuardOptions
from skincal.model.arrays import FloatArray
from skincal.signals import held_back

LONGEST_PERIOD_S = 1.0
"""Longest period of a controlled rig [s]."""

PATIENCE = 10.0
"""Factor by which a simulated rig may take longer to connect; compilation takes about 15 s on an idle core."""

Value = TypeVar("Value")


class Guarded(ABC, Generic[Description, State, Command]):
    """A rig that is safe to move: used like a driver, within a ``with`` block, for one connection.

    A separate thread of the guard makes all calls to the driver, except for ``stop``.

    Args:
        driver: the rig, not connected.
        options: limits and times; ``max_force_n`` replaces that of the description.
        clock: our clock [s].

    Attributes:
        name: the driver's name.
    """

    rig: ClassVar[str]
    """Name of the kind of rig in errors."""
    advice: ClassVar[Mapping[HandErrorKind, str]] = ADVICE
    """Advice by kind of error, where there is any."""

    def __init__(
        self,
        driver: Driver[Description, State, Command],
        options: GuardOptions | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._made: Any = driver
        self.name = one_line(str(getattr(driver, "name", type(driver).__name__)), 60)
        self._options = options or GuardOptions()
        self._clock = clock
        self._worker: Worker | None = None
        self._lock = Lock()
        self._failure: HandError | None = None
        self._halt = Stop(lambda: self._made.stop(), self._options.stop_timeout_s, self.name, self.rig)
        self._closed = False
        self._period_s: float | None = None

    @abstractmethod
    def _check_limits(self) -> None:
        """Refuse a description with limits beyond all bounds, by an ``InputError``, before connecting."""

    @abstractmethod
    def _checks(self) -> tuple[Any, Any]:
        """Return the checks of states and of commands of the connected rig."""

    @property
    def description(self) -> Description:
        """The rig: limits, geometry, sensor."""
        return self._made.description

    @property
    def period_s(self) -> float:
        """Time between two states [s], on the rig's clock."""
        return self._made.period_s if self._period_s is None else self._period_s

    @property
    def real_time(self) -> bool:
        """True if the rig's clock runs as fast as ours."""
        return self._made.real_time

    @property
    def failure(self) -> HandError | None:
        """Error for which the guard stopped the rig; None without a fault."""
        return self._failure

    def connect(self) -> None:
        """Connect to the rig.

        Raises:
            InputError: the limits of its description are beyond all bounds.
            HandError: it does not respond, or has been connected before.
        """
        if self._worker is not None:
            raise HandError(
                f"{self.name}: a guarded {self.rig} connects only once; create a new one", "order"
            )
        options = self._options
        self._check_limits()
        self._worker = Worker(f"{self.rig} {self.name}", options.idle_s, self._idle)
        atexit.register(self._at_exit)
        note_stop(self._halt)
        # A simulated rig may compile its skin model first, which takes longer on a busy machine.
        patience = 1.0 if self._made.real_time else PATIENCE
        try:
            self._call("connect", self._made.connect, timeout_s=patience * options.connect_timeout_s)
            checks = self._call("description", self._described, timeout_s=options.timeout_s)
            self._check_state, self._check_command = checks
            # A full garbage collection looks at every object of the process, for as long as a state may be late, in
            # whichever period it falls. Those that are there by now are left out until the rig is released.
            gc.freeze()
        except BaseException as error:
            # The exit of a `with` block that was not entered is not called.
            if isinstance(error, HandError) and error.stopped is not None:
                self._leave(error, "")
            else:
                self.__exit__(type(error), error, None)
            raise

    def _described(self) -> tuple[Any, Any]:
        """Run in the worker, as a driver's attributes may hang or raise too: return the checks."""
        period_s = self._made.period_s
        if not 0 < period_s <= LONGEST_PERIOD_S:
            expected = f"a time above 0 s, {LONGEST_PERIOD_S:g} s at most"
            raise HandError(f"period_s: expected {expected}; got {shown(period_s)}", "driver")
        self._period_s = float(period_s)  # a driver's own may change, or fail, later
        return self._checks()

    def observe(self) -> State:
        """Wait for the next state, check it and return it.

        Raises:
            HandError: a check failed; the rig has been stopped.
        """
        start_s = self._clock()
        state: State = self._call("observe", self._made.observe, timeout_s=self._options.timeout_s)
        return self._checked(state, start_s)

    def _checked(self, state: State, start_s: float) -> State:
        """Check a state that was requested at ``start_s`` on our clock [s]; return it with arrays of its own."""
        now_s = self._clock()
        try:
            state = _own(state)
            self._check_state(state, now_s, now_s - start_s)
        except HandError as violation:
            self._fail(described("observe", violation))
        except (Exception, SystemExit) as error:  # whole numbers beyond a float, classes of the driver's own
            self._fail(HandError(f"a state that cannot be read: {quoted(error)}", "state"))
        self._check_command.observed(state, now_s)
        return state

    def nearest(self, target: FloatArray) -> Command:
        """Return the allowed command nearest to a target (n,) in the unit of commands, within limits and speed."""
        self._ready("nearest")
        return self._check_command.nearest(target, self._clock())

    def act(self, command: Command) -> None:
        """Check a command and send it.

        Raises:
            HandError: the command breaks a limit and was not sent, or the driver failed; the rig has been stopped.
        """
        self._ready("act")
        if self._halt.asked:
            raise HandError(
                f"{self.name}: the {self.rig} has been stopped; connect again to move it", "stopped"
            )
        own = _own(command)
        try:
            self._check_command(own, self._clock())
        except HandError as violation:
            if violation.kind == "order":
                raise
            self._fail(violation)
        self._call("act", self._send, _own(own), timeout_s=self._options.timeout_s)
        self._check_command.sent(own, self._clock())

    def stop(self) -> None:
        """Stop the rig; may be called at any time and from any thread. States can still be observed.

        Raises:
            HandError: the driver's ``stop`` raised, or did not return.
        """
        trouble = self._halt()
        if trouble:
            raise HandError(f"{self.name}: {trouble}", "driver", stopped=False)

    def close(self) -> None:
        """Release the rig. May be called twice.

        Raises:
            HandError: the driver's ``close`` raised, or did not return; the rig is stopped.
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
        """Stop the rig, whatever happened, and release it. Add a note to the exception that the rig was stopped.

        Raises:
            HandError: the rig could not be stopped.
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
                self._leave(interrupt, self._halt())
            raise
        self._leave(error, trouble)

    def _leave(self, error: BaseException | None, trouble: str) -> None:
        """Release the rig, and report whether it was stopped."""
        reported = isinstance(error, HandError) and error.stopped is False
        try:
            if not (trouble or reported or isinstance(error, KeyboardInterrupt)):
                self.close()
            elif self._worker is not None and not self._closed:
                # Do not delay a user who must cut the power, or a process that is to end.
                self._give_back(self._worker, min(self._options.connect_timeout_s, HURRY_S))
        except HandError:
            # The exception of the block matters, not a failure to close after it.
            if error is None:
                raise
        except BaseException as interrupt:
            self._report(interrupt, trouble)
            raise
        self._report(error, trouble)

    def _report(self, error: BaseException | None, trouble: str) -> None:
        """Note on the block's exception that the rig was stopped; raise an error if it was not."""
        if isinstance(error, HandError) and error.stopped is not None:
            return
        if trouble:
            reason = ""
            if error is not None:
                reason = "interrupted; " if isinstance(error, KeyboardInterrupt) else f"{text_of(error)}; "
            raise HandError(f"{self.name}: {reason}{trouble}", "driver", stopped=False) from error
        if error is not None:
            error.add_note(stopped(self.rig))

    def _at_exit(self) -> None:
        """Stop a rig that is still connected at the end of the process."""
        trouble = self._halt()
        if trouble:
            print(f"{self.name}: {trouble}", file=sys.stderr)

    def _ready(self, what: str) -> Worker:
        """Return the worker of a connected rig without faults."""
        if self._failure is not None:
            raise self._failure.again()
        if self._worker is None or self._closed:
            raise HandError(f"{self.name}: {what}() of a {self.rig} that is not connected", "order")
        return self._worker

    def _call(self, what: str, work: Callable[..., Any], *arguments: Any, timeout_s: float) -> Any:
        """Make a call to the driver; stop the rig on any fault."""
        worker = self._ready(what)
        try:
            return worker.call(self._unless_failed, work, arguments, timeout_s=timeout_s)
        except CallTimeoutError:
            text = f"{what}() did not return within {timeout_s:g} s"
            self._fail(HandError(text, "timeout", value=timeout_s, limit=timeout_s))
        except Exception as error:
            if self._failure is not None:
                raise self._failure.again() from None
            raised = raised_by(error)
            self._fail(described(what, raised), cause=raised)
        except BaseException:
            self._halt()
            raise

    def _unless_failed(self, work: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Run in the worker: do nothing if the rig was stopped while the call waited for its turn."""
        if self._failure is not None:
            raise self._failure
        return work(*arguments)

    def _send(self, command: Command) -> None:
        """Run in the worker: send nothing if the rig was stopped while the command waited for its turn."""
        if self._halt.asked:
            raise HandError(f"the {self.rig} has been stopped; the command was not sent", "stopped")
        self._made.act(command)

    def _fail(self, violation: HandError, cause: BaseException | None = None) -> NoReturn:
        """Stop the rig and raise the violation, with what became of the rig; only the first failure counts."""
        trouble = self._halt()
        end = trouble or f"{stopped(self.rig)} {self.advice.get(violation.kind, '')}".rstrip()
        error = violation.again(f"{self.name}: {violation}. {end}", stopped=not trouble)
        with self._lock:
            self._failure = self._failure or error
        raise error from cause

    def _idle(self) -> None:
        """Run in the worker: stop a rig that has not been called for ``idle_s``."""
        if self._closed or self._halt.asked:
            return
        idle_s = self._options.idle_s
        with suppress(HandError):  # the next call raises it
            self._fail(HandError(f"no call for {idle_s:g} s", "idle", limit=idle_s))

    def _give_back(self, worker: Worker, timeout_s: float | None = None) -> HandError | None:
        """Close the driver and let the worker end; return the error of closing, or None."""
        self._closed = True
        gc.unfreeze()
        atexit.unregister(self._at_exit)
        options = self._options
        timeout_s = timeout_s or options.connect_timeout_s
        hung = self._failure is not None and self._failure.kind == "timeout"
        try:
            # A driver with a hanging call cannot be closed; do not wait.
            worker.call(lambda: None, timeout_s=options.stop_timeout_s if hung else options.timeout_s)
            worker.call(self._made.close, timeout_s=timeout_s)
        except CallTimeoutError:
            return HandError(f"{self.name}: close() did not return within {timeout_s:g} s", "timeout")
        except Exception as error:
            return HandError(f"{self.name}: {described('close', raised_by(error))}", "driver")
        finally:
            worker.end()
        return None


def _own(value: Value) -> Value:
    """Return a state or command whose arrays are nobody else's.

    A driver may fill the same arrays in every period, from a thread of its own too, and convert a command in place; a
    caller may reuse the array of a command. What was checked must be what is stored, sent and compared.
    """
    if type(value) is np.ndarray:
        return value.copy()
    if not is_dataclass(value) or isinstance(value, type):
        return value
    # dataclasses.replace would take five times as long, in every period.
    own = copy(value)
    for one in fields(value):
        if type(array := getattr(own, one.name)) is np.ndarray:
            object.__setattr__(own, one.name, array.copy())
    return own
