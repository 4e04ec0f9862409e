"""What a hand is to skincal: connect, observe, act, stop.

A driver is a thin thing: it moves values between a hand and these types. It enforces nothing and waits for nobody;
limits and time-outs are ours (:mod:`skincal.hand.guard`), so that a driver that forgets them does no harm.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from skincal.robot.description import HandDescription

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HandState:
    """What a hand says of itself at one moment.

    Attributes:
        time_s: clock of the joints [s]; it never goes back. A simulated hand has a clock of its own, that may run
            faster than ours.
        q_rad: measured joint angles (n,) [rad], in the order of the description's joints.
        dq_rad_per_s: joint velocities (n,) [rad/s].
        tau_nm: measured joint torques (n,) [N m]: positive accelerates the joint towards growing angles.
        q_desired_rad: the angles that the hand's controller now holds to (n,) [rad].
        taxels: taxel values (rows * cols,) [counts], flat index r * cols + c; NaN where a taxel does not answer.
        taxel_time_s: the moment at which each taxel was read (rows * cols,) [s], on the clock of `time_s`.
        temperature_c: temperature at the skin [deg C]; NaN where it is not measured.
    """

    time_s: float
    q_rad: FloatArray
    dq_rad_per_s: FloatArray
    tau_nm: FloatArray
    q_desired_rad: FloatArray
    taxels: FloatArray
    taxel_time_s: FloatArray
    temperature_c: float = float("nan")


@dataclass(frozen=True, eq=False)
class HandCommand:
    """What a hand is asked to do until the next command.

    Attributes:
        q_desired_rad: joint angles to hold to (n,) [rad]; the hand's own joint impedance controller follows them.
    """

    q_desired_rad: FloatArray


class HandDriver(ABC):
    """A hand: a context manager that is observed and acted upon.

    The loop of a user is ``state = hand.observe(); hand.act(command(state))``, once every :attr:`period_s` of the
    hand's clock.

    Calls come from one thread, but :meth:`stop` may come from another while a call hangs.
    """

    name: str
    """The name under which the driver is registered."""

    follows_commands: bool = True
    """Whether the hand does what it is told; one that plays a recording does not."""

    real_time: bool = True
    """Whether the hand's clock runs as fast as ours; that of a simulated or a recorded hand runs as it likes."""

    @property
    @abstractmethod
    def description(self) -> HandDescription:
        """The hand: joints, limits, kinematics, sensor. Known before connecting."""

    @property
    @abstractmethod
    def period_s(self) -> float:
        """Time between two states [s], on the hand's clock."""

    @abstractmethod
    def connect(self) -> None:
        """Take the hand; it holds the angles it has.

        Raises:
            WorkError: the hand does not answer.
        """

    @abstractmethod
    def observe(self) -> HandState:
        """Wait for the next state and returns it. A simulated hand moves on by one period."""

    @abstractmethod
    def act(self, command: HandCommand) -> None:
        """Send a command; returns without waiting for its effect."""

    def object_position_m(self) -> FloatArray | None:
        """Where the object between the fingers truly is: patch coordinates of its place on the sensor (2,) [m].

        None: the hand has nothing that sees it, as most hands have not.
        """
        return None

    @abstractmethod
    def stop(self) -> None:
        """Bring the hand to a halt, with no more force than it exerts now.

        May be called twice, at any time, and from any thread.
        """

    @abstractmethod
    def close(self) -> None:
        """Give the hand back. May be called twice."""

    def __enter__(self) -> Self:
        """Connect."""
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the hand, whatever happened, and gives it back."""
        try:
            self.stop()
        finally:
            self.close()
