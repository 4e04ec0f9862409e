"""What goes wrong with a hand: one error, whose kind a program can act on."""

from __future__ import annotations

from typing import Literal, get_args

from skincal.errors import WorkError

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
