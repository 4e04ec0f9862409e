"""What goes wrong with a hand: one error, whose kind a program can act on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from skincal.errors import SkincalError, WorkError

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
"""What happened.

``state``: a state has a wrong type or shape, or holds NaN. ``clock``: the hand's clock went back or stands still.
``taxels``: taxel values or their time stamps are of no use. ``joint_limit``, ``velocity``, ``torque``, ``force``: a
measured value is above its limit. ``command``: a command was not sent, as it breaks a limit. ``timeout``: a call took
too long. ``driver``: the driver raised. ``lost``: the connection is gone. ``refused``: the hand's side said no.
``idle``: nobody moved the hand for too long. ``order``: a call at a time at which it means nothing. ``stopped``: the
hand has been stopped before. ``end``: a recorded session is over.
"""

KINDS: tuple[str, ...] = get_args(HandErrorKind)

ADVICE: dict[HandErrorKind, str] = {
    "state": "See what the driver hands out: `skincal hand test`.",
    "clock": "See that the hand is still running, and which clock the driver hands out.",
    "taxels": "See that the sensor is connected, and which clock stamps its values.",
    "joint_limit": "See where the finger is before connecting again, and the limits in hand.toml.",
    "velocity": "See what moves the finger, and the limits in hand.toml.",
    "torque": "See what the finger pushes against, and the limits in hand.toml.",
    "force": "See what the fingers press on, and max_force_n in hand.toml.",
    "command": "The command was not sent.",
    "timeout": "See that the hand is still running and can be reached.",
    "driver": "The fault lies in the driver or in the hand.",
    "lost": "See that the hand is still running and can be reached, and connect again.",
    "refused": "",
    "idle": "Whoever moves a hand calls it in every period; connect again.",
    "order": "",
    "stopped": "",
    "end": "",
}
"""What to do about it, by kind."""


@dataclass(frozen=True)
class Violation:
    """One thing that may not be, as :class:`HandError` tells it."""

    kind: HandErrorKind
    text: str
    joint: str | None = None
    value: float | None = None
    limit: float | None = None


class HandError(WorkError):
    """A hand cannot go on.

    Attributes:
        kind: what happened, for programs.
        joint: name of the joint that it happened to; None: no single one.
        value: what was measured or commanded; None where it is no number.
        limit: what it had to keep.
        stopped: whether the driver's ``stop`` returned; None where none was asked for.
    """

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
        self.kind: HandErrorKind = kind
        self.joint = joint
        self.value = value
        self.limit = limit
        self.stopped = stopped
        super().__init__(text)


def again(failure: HandError) -> HandError:
    """Return the same error anew: one that is raised twice would grow by a traceback each time."""
    joint, value, limit = failure.joint, failure.value, failure.limit
    return HandError(
        str(failure), failure.kind, joint=joint, value=value, limit=limit, stopped=failure.stopped
    )


def described(what: str, error: BaseException | None) -> tuple[HandErrorKind, str]:
    """Return the kind and text of what a driver raised in a call."""
    if isinstance(error, HandError):
        return error.kind, str(error).rstrip(".")
    if isinstance(error, SkincalError):
        return "driver", str(error).rstrip(".")
    text = f"{what}() raised {type(error).__name__}: {error}".rstrip(".")
    return ("lost" if isinstance(error, ConnectionError | EOFError) else "driver"), text


def shown(value: Any) -> str:
    """Return a value of a wrong type or shape, briefly."""
    if isinstance(value, np.ndarray):
        array = cast(NDArray[Any], value)
        return f"an array of {array.dtype} of shape {array.shape}"
    return f"{type(value).__name__} {value!r:.60}"
