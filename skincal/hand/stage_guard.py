"""The guard of a stage: it checks every state and every command, and stops the stage on any fault."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Any, NoReturn, Self

import numpy as np

from skincal.hand.errors import HandError, HandErrorKind, described
from skincal.hand.options import GuardOptions
from skincal.hand.stage import FloatArray, StageDescription, StageDriver, StageState
from skincal.hand.worker import CallTimeoutError, Worker, call_and_leave

ROUNDING_M = 1e-9
"""Tolerance of a command's limits, for rounding [m]."""

BEYOND_M = 0.5e-3
"""Tolerance of a measured position beyond the travel, for overshoot [m]."""


class GuardedStage:
    """A stage that is safe to move: limits of travel, speed and force, and calls that return in time.

    Args:
        driver: the stage.
        options: time-outs; ``max_force_n`` replaces that of the description.
    """

    def __init__(self, driver: StageDriver, options: GuardOptions | None = None) -> None:
        self._driver, self._options = driver, options or GuardOptions()
        self._limit_n = self._options.max_force_n or driver.description.max_force_n
        self._worker: Worker | None = None
        self._failed: HandError | None = None
        self._last: StageState | None = None
        self._sent: FloatArray | None = None

    @property
    def description(self) -> StageDescription:
        """The rig."""
        return self._driver.description

    @property
    def period_s(self) -> float:
        """Time between two states [s]."""
        return self._driver.period_s

    def __enter__(self) -> Self:
        """Connect.

        Raises:
            HandError: the stage does not respond, or has been connected before.
        """
        if self._worker is not None:
            raise HandError(
                f"{self._driver.name}: a guarded stage connects only once; create a new one", "order"
            )
        self._worker = Worker(f"stage {self._driver.name}")
        try:
            self._call("connect", self._driver.connect, timeout_s=self._options.connect_timeout_s)
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the stage, whatever happened, and release it."""
        trouble = self._halt()
        self._close()
        if trouble and error is None:
            raise HandError(f"{self._driver.name}: {trouble}", "driver", stopped=False)

    def observe(self) -> StageState:
        """Wait for the next state, check it and return it.

        Raises:
            HandError: a check failed; the stage has been stopped.
        """
        state: StageState = self._call("observe", self._driver.observe, timeout_s=self._options.timeout_s)
        rig, sensor = self.description, self.description.meta.sensor
        place, taxels = np.asarray(state.position_m), np.asarray(state.taxels)
        if place.shape != (3,) or not np.isfinite([*place, state.force_n, state.time_s]).all():
            self._fail("state", f"expected a finite time, position (3,) and force; got {state}")
        if taxels.shape != (sensor.rows * sensor.cols,):
            self._fail("taxels", f"expected {sensor.rows * sensor.cols} taxel values; got {taxels.shape}")
        if self._last is not None and state.time_s <= self._last.time_s:
            self._fail("clock", f"expected a time after {self._last.time_s:.6g} s; got {state.time_s:.6g} s")
        if abs(state.force_n) > self._limit_n:
            text = f"the force is {state.force_n:.3g} N, above the limit of {self._limit_n:.3g} N"
            self._fail("force", text)
        if (place < rig.lower_m - BEYOND_M).any() or (place > rig.upper_m + BEYOND_M).any():
            self._fail("joint_limit", f"the tip is at {_shown(place)}, outside its travel")
        self._last = state
        return state

    def act(self, position_m: FloatArray) -> None:
        """Check a command and send it.

        Raises:
            HandError: the command leaves the travel or is too fast, and was not sent; the stage has been stopped.
        """
        if self._last is None:
            raise HandError(f"{self._driver.name}: observe a state before the first command", "order")
        place = np.array(position_m, dtype=np.float64)
        rig, base = self.description, self._last.position_m if self._sent is None else self._sent
        if place.shape != (3,) or not np.isfinite(place).all():
            self._fail("command", f"expected a position (3,) of finite numbers; got {place}")
        if (place < rig.lower_m - ROUNDING_M).any() or (place > rig.upper_m + ROUNDING_M).any():
            self._fail("command", f"{_shown(place)} lies outside the travel")
        step = float(np.linalg.norm(place - base))
        longest = rig.max_speed_m_per_s * self.period_s
        if step > longest + ROUNDING_M:
            text = f"a step of {1e3 * step:.3g} mm in a period; at most {1e3 * longest:.3g} mm are allowed"
            self._fail("command", text)
        self._call("act", self._driver.act, place, timeout_s=self._options.timeout_s)
        self._sent = place

    def stop(self) -> None:
        """Stop the stage; may be called at any time and from any thread.

        Raises:
            HandError: the driver's ``stop`` raised, or did not return.
        """
        trouble = self._halt()
        if trouble:
            raise HandError(f"{self._driver.name}: {trouble}", "driver", stopped=False)

    def _call(self, what: str, work: Callable[..., Any], *arguments: Any, timeout_s: float) -> Any:
        if self._failed is not None:
            raise self._failed
        if self._worker is None:
            raise HandError(f"{self._driver.name}: {what}() of a stage that is not connected", "order")
        try:
            return self._worker.call(work, *arguments, timeout_s=timeout_s)
        except CallTimeoutError:
            self._fail("timeout", f"{what}() did not return within {timeout_s:g} s")
        except (Exception, SystemExit) as error:
            kind, text = described(what, error)
            self._fail(kind, text, error)
        except BaseException:
            self._halt()
            raise

    def _fail(self, kind: HandErrorKind, text: str, cause: BaseException | None = None) -> NoReturn:
        trouble = self._halt()
        end = trouble or "The stage was stopped."
        self._failed = HandError(f"{self._driver.name}: {text}. {end}", kind, stopped=not trouble)
        raise self._failed from cause

    def _halt(self) -> str:
        """Call the driver's ``stop``, twice if it raises; return the failure to do so, or ''."""
        trouble = ""
        for _ in range(2):
            try:
                call_and_leave(self._driver.stop, self._options.stop_timeout_s, f"stop {self._driver.name}")
                return ""
            except CallTimeoutError:
                return (
                    f"stop() did not return within {self._options.stop_timeout_s:g} s! Cut the stage's power."
                )
            except (Exception, SystemExit) as error:
                trouble = f"stop() failed! {type(error).__name__}: {error}. Cut the stage's power."
        return trouble

    def _close(self) -> None:
        if self._worker is None:
            return
        hung = self._failed is not None and self._failed.kind == "timeout"
        timeout_s = self._options.stop_timeout_s if hung else self._options.connect_timeout_s
        try:
            self._worker.call(self._driver.close, timeout_s=timeout_s)
        except (CallTimeoutError, Exception, SystemExit):
            # The cause of the session's end has been reported; the stage is stopped.
            return
        finally:
            self._worker.end()


def _shown(place: FloatArray) -> str:
    return "(" + ", ".join(f"{1e3 * x:.3g}" for x in place) + ") mm"
