"""Errors of a hand: one class, with a kind that programs can act on."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from skincal.errors import SkincalError, WorkError, quoted, text_of

HandErrorKind = Literal[
    "state",
    "clock",
    "taxels",
    "joint_limit",
    "velocity",
    "torque",
    "force",
    "command",
    "timeout",
    "driver",
    "lost",
    "refused",
    "idle",
    "order",
    "stopped",
    "end",
]
"""Kinds of errors.

``state``: a state has a wrong type or shape, or holds NaN. ``clock``: the hand's clock went back or stands still.
``taxels``: taxel values or their time stamps are invalid. ``joint_limit``, ``velocity``, ``torque``, ``force``: a
measured value exceeds its limit. ``command``: a command was not sent because it breaks a limit. ``timeout``: a call
took too long. ``driver``: the driver raised. ``lost``: the connection is lost. ``refused``: the server side refused.
``idle``: the hand was not commanded for too long. ``order``: a call at an invalid time. ``stopped``: the hand has been
stopped before. ``end``: a recorded session has ended.
"""

KINDS: tuple[str, ...] = get_args(HandErrorKind)

MOST_LETTERS = 1000
"""Longest text of an error of a driver's own [letters]."""

_NUMBERS: tuple[type, ...] = (float, int, np.float32, np.integer)
"""Kinds of single numbers that a driver may give; a long double or a complex number fits no table."""

ADVICE: dict[HandErrorKind, str] = {
    "state": "Check the states of the driver: `skincal hand test`.",
    "clock": "Check that the hand is still running, and which clock the driver reports.",
    "taxels": "Check that the sensor is connected, and which clock stamps its values.",
    "joint_limit": "Check the finger's position before connecting again, and the limits in hand.toml.",
    "velocity": "Check what moves the finger, and the limits in hand.toml.",
    "torque": "Check what the finger pushes against, and the limits in hand.toml.",
    "force": "Check what the fingers press on, and max_force_n in hand.toml.",
    "command": "The command was not sent.",
    "timeout": "Check that the hand is still running and can be reached.",
    "driver": "The fault lies in the driver or in the hand.",
    "lost": "Check that the hand is still running and can be reached, then connect again.",
    "idle": "Call the hand in every period; connect again.",
}
"""Advice by kind of error, where there is any."""


def is_number(value: object) -> bool:
    """Return whether a value of a driver is a single number; one of a class of its own may run any code."""
    kind = type(value)
    return isinstance(value, _NUMBERS) and kind is not bool and kind.__module__ in ("builtins", "numpy")


class HandError(WorkError):
    """Error after which a hand cannot continue.

    Attributes:
        kind: kind of the error, for programs.
        joint: name of the joint concerned; None: no single one.
        value: measured or commanded value; None if it is not a number.
        limit: limit of the value.
        stopped: whether the driver's ``stop`` returned; None if it was not called.
    """

    # Of a driver's own subclass that sets none of them.
    kind: HandErrorKind = "driver"
    joint: str | None = None
    value: float | None = None
    limit: float | None = None
    stopped: bool | None = None

    def __init__(
        self,
        text: str,
        kind: HandErrorKind,
        *,
        joint: str | None = None,
        value: float | None = None,
        limit: float | None = None,
        stopped: bool | None = None,
    ) -> None:
        self.kind = kind
        self.joint = joint
        self.value = value
        self.limit = limit
        self.stopped = stopped
        super().__init__(text)

    def again(self, text: str | None = None, *, stopped: bool | None = None) -> HandError:
        """Return a copy, or the error of the same values with another text and end.

        An error that is raised twice would grow by a traceback each time.
        """
        told, stopped = (str(self), self.stopped) if text is None else (text, stopped)
        return HandError(
            told, self.kind, joint=self.joint, value=self.value, limit=self.limit, stopped=stopped
        )


def described(what: str, error: BaseException) -> HandError:
    """Return the error of a driver's call as one of ours, of sound values: its own may hold anything."""
    if isinstance(error, HandError):
        text = (text_of(error, MOST_LETTERS) or quoted(error)).rstrip(".")
        try:
            kind = error.kind if error.kind in KINDS else "driver"
            joint = error.joint if isinstance(error.joint, str) else None
            value, limit = (None if x is None else float(x) for x in (error.value, error.limit))
            return HandError(text, kind, joint=joint, value=value, limit=limit)
        except Exception:  # values that are no numbers
            return HandError(text, "driver")
    if isinstance(error, SkincalError):
        return HandError(text_of(error, MOST_LETTERS).rstrip("."), "driver")
    kind = "lost" if isinstance(error, ConnectionError | EOFError) else "driver"
    return HandError(f"{what}() raised {quoted(error)}".rstrip("."), kind)
