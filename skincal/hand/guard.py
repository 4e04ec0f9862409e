"""The guard: what stands between a hand and whoever moves it.

Every state is checked before it is handed on, every command before it is sent. Whatever goes wrong, the driver's
``stop`` is called, and an error says what happened. A command that breaks a limit is *refused* and stops the hand; it
is not cut down to what is allowed, because then the hand would do something that nobody asked for, and whoever asked
would not know. Who wants the nearest allowed command asks for it: :meth:`GuardedHand.nearest`.

Times: from a bad state, a bad command or an exception to the call of ``stop`` a millisecond passes; from a call that
hangs, ``timeout_s``. Python cannot leave a driver that hangs in foreign code without releasing the interpreter lock.
"""

from __future__ import annotations

import atexit
import math
import time
from collections.abc import Callable
from threading import Lock
from types import TracebackType
from typing import Any, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from skincal.hand.checks import CommandCheck, StateCheck, Violation
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import ADVICE, HandError, HandErrorKind, again, described
from skincal.hand.options import GuardOptions
from skincal.hand.worker import CallTimeoutError, Worker, call_and_leave
from skincal.robot.description import HandDescription

FloatArray = NDArray[np.float64]
ContactForce = Callable[[HandState], float]

POWER = "Cut the hand's power."


class GuardedHand:
    """A hand that is safe to move: used as a driver is, within a ``with`` block, for one connection.

    Calls to the driver are made by one thread of the guard's own, except for ``stop``.

    Args:
        driver: the hand.
        options: limits and times.
        contact_force: the contact force of a state [N], from its joint angles and torques; None: not checked.
    """

    def __init__(
        self,
        driver: HandDriver,
        options: GuardOptions | None = None,
        contact_force: ContactForce | None = None,
    ) -> None:
        self._driver = driver
        self._options = options or GuardOptions()
        self._contact_force = contact_force
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
    def failure(self) -> HandError | None:
        """Why the hand was stopped by the guard; None while all is well."""
        return self._failure

    def connect(self) -> None:
        """Takes the hand.

        Raises:
            HandError: it does not answer, or has been connected before.
        """
        if self._worker is not None:
            raise HandError(f"{self.name}: a guarded hand is connected once; make a new one", "order")
        description, options = self._driver.description, self._options
        self._check_state = StateCheck(description, options)
        self._max_force_n = options.max_force_n or description.max_force_n
        self._sent: FloatArray | None = None
        self._before: FloatArray | None = None
        self._worker = Worker(f"hand {self.name}", options.idle_s, self._idle)
        atexit.register(self.stop)
        try:
            self._call("connect", self._driver.connect, timeout_s=options.connect_timeout_s)
            self._check_command = CommandCheck(description, self._driver.period_s)
        except BaseException:
            # A `with` block that was not entered does not leave.
            self._give_back()
            raise

    def observe(self) -> HandState:
        """Waits for the next state, checks it and returns it.

        Raises:
            HandError: something is wrong; the hand has been stopped.
        """
        state: HandState = self._call("observe", self._driver.observe, timeout_s=self._options.timeout_s)
        violation = self._check_state(state, time.monotonic()) or self._check_force(state)
        if violation is not None:
            self._violated(violation)
        # Before the first command, the hand holds to what it says.
        self._before = state.q_desired_rad if self._sent is None else self._sent
        return state

    def act(self, command: HandCommand) -> None:
        """Checks a command and sends it.

        Raises:
            HandError: the command breaks a limit and was not sent, or the driver failed; the hand has been stopped.
        """
        self._ready("act")
        if self._halted:
            raise HandError(f"{self.name}: the hand has been stopped; connect anew to move it", "stopped")
        violation = self._check_command(command, self._base())
        if violation is not None:
            self._violated(violation)
        self._call("act", self._driver.act, command, timeout_s=self._options.timeout_s)
        # A copy: whoever made the command may use its array again.
        self._sent = command.q_desired_rad.copy()

    def nearest(self, q_desired_rad: FloatArray) -> HandCommand:
        """The allowed command that is nearest to these angles (n,) [rad], within joint limits and speed."""
        return HandCommand(self._check_command.nearest(q_desired_rad, self._base()))

    def stop(self) -> None:
        """Stops the hand; may be called at any time and from any thread. States can still be observed.

        Raises:
            HandError: the driver's ``stop`` raised, or did not return.
        """
        trouble = self._halt()
        if trouble:
            raise HandError(f"{self.name}: {trouble}", "driver", stopped=False)

    def close(self) -> None:
        """Gives the hand back. May be called twice.

        Raises:
            HandError: the driver's ``close`` raised, or did not return; the hand is stopped.
        """
        if self._closed or self._worker is None:
            return
        error = self._give_back()
        if error is not None and self._failure is None:
            raise error

    def __enter__(self) -> Self:
        """Connects."""
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stops the hand, whatever happened, and gives it back."""
        trouble = self._halt()
        try:
            self.close()
        except HandError:
            # What ended the block is the news, not that closing failed after it.
            if error is None:
                raise
        if trouble and error is None:
            raise HandError(f"{self.name}: {trouble}", "driver", stopped=False)

    def _ready(self, what: str) -> Worker:
        """The worker, where the hand is connected and nothing has gone wrong."""
        if self._failure is not None:
            raise again(self._failure)
        if self._worker is None or self._closed:
            raise HandError(f"{self.name}: {what}() of a hand that is not connected", "order")
        return self._worker

    def _base(self) -> FloatArray:
        """What was commanded when the last state came (n,) [rad]: the next command steps from there."""
        if self._before is None:
            raise HandError(f"{self.name}: observe a state before the first command", "order")
        return self._before

    def _call(self, what: str, work: Callable[..., Any], *arguments: Any, timeout_s: float) -> Any:
        """Makes a call to the driver; whatever goes wrong, the hand is stopped."""
        worker = self._ready(what)
        try:
            return worker.call(self._unless_failed, work, arguments, timeout_s=timeout_s)
        except CallTimeoutError:
            text = f"{what}() did not return within {timeout_s:g} s"
            self._fail("timeout", text, value=timeout_s, limit=timeout_s)
        except (Exception, SystemExit) as error:
            if self._failure is not None:
                raise again(self._failure) from None
            kind, text = described(what, error)
            own = error if isinstance(error, HandError) else HandError(text, kind)
            self._fail(kind, text, own.joint, own.value, own.limit, cause=error)
        except BaseException:
            self._halt()
            raise

    def _unless_failed(self, work: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """In the worker: nothing is sent after the hand was stopped while the call waited for its turn."""
        if self._failure is not None:
            raise self._failure
        return work(*arguments)

    def _check_force(self, state: HandState) -> Violation | None:
        if self._contact_force is None:
            return None
        try:
            force_n = float(self._contact_force(state))
        except Exception as error:
            return Violation(
                "force", f"the contact force cannot be computed: {type(error).__name__}: {error}"
            )
        if math.isfinite(force_n) and abs(force_n) <= self._max_force_n:
            return None
        limit_n = self._max_force_n
        text = f"contact force is {force_n:.3g} N, above the limit of {limit_n:.3g} N"
        return Violation("force", text, value=force_n, limit=limit_n)

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
        """Stops the hand, and raises what happened; the first failure is the one that counts."""
        trouble = self._halt()
        end = trouble or f"The hand was stopped. {ADVICE[kind]}"
        error = HandError(
            f"{self.name}: {text}. {end}", kind, joint=joint, value=value, limit=limit, stopped=not trouble
        )
        with self._lock:
            self._failure = self._failure or error
        raise error from cause

    def _halt(self) -> str:
        """Calls the driver's ``stop``, a second time if it raises.

        Returns:
            What went wrong with it; empty: the hand was stopped.
        """
        self._halted = True
        trouble = ""
        for _ in range(2):
            try:
                call_and_leave(self._driver.stop, self._options.stop_timeout_s, f"stop {self.name}")
                return ""
            except CallTimeoutError:
                return f"stop() did not return within {self._options.stop_timeout_s:g} s! {POWER}"
            except (Exception, SystemExit) as error:
                trouble = f"stop() failed! {type(error).__name__}: {error}. {POWER}"
        return trouble

    def _idle(self) -> None:
        """In the worker: nobody has called for ``idle_s``."""
        if self._closed or self._halted:
            return
        try:
            self._fail("idle", f"no call for {self._options.idle_s:g} s", limit=self._options.idle_s)
        except HandError:
            # The next call raises it.
            return

    def _give_back(self) -> HandError | None:
        """Closes the driver and lets the worker end. Returns what went wrong."""
        self._closed = True
        atexit.unregister(self.stop)
        if self._worker is None:
            return None
        timeout_s = self._options.connect_timeout_s
        if self._failure is not None and self._failure.kind == "timeout":
            # The worker still waits for the call that hangs; closing comes after it, if it ever ends.
            timeout_s = self._options.stop_timeout_s
        try:
            self._worker.call(self._driver.close, timeout_s=timeout_s)
        except CallTimeoutError:
            return HandError(f"{self.name}: close() did not return within {timeout_s:g} s", "timeout")
        except (Exception, SystemExit) as error:
            return HandError(f"{self.name}: {described('close', error)[1]}", "driver")
        finally:
            self._worker.end()
        return None
