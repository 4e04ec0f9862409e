"""The driver interfaces of a hand and of a stage: connect, observe, act, stop.

A driver is thin: it moves values between a rig and these types. It enforces no limits and needs no time-outs; the
guard (:mod:`skincal.hand.guard`) has them, so that a driver that forgets them does no harm.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import TracebackType
from typing import Generic, Self, TypeVar

from skincal.dataset import DatasetMeta
from skincal.model.arrays import FloatArray
from skincal.robot.description import HandDescription, HandState

Description = TypeVar("Description")
State = TypeVar("State")
Command = TypeVar("Command")


@dataclass(frozen=True, eq=False)
class HandCommand:
    """Command of a hand until the next one.

    Attributes:
        q_desired_rad: target joint angles (n,) [rad]; the hand's own joint impedance controller follows them.
    """

    q_desired_rad: FloatArray


class Driver(ABC, Generic[Description, State, Command]):
    """A rig, hand or stage: it is observed and commanded.

    A user's loop is ``state = rig.observe(); rig.act(command(state))``, once every :attr:`period_s` of the rig's clock.

    Calls come from one thread, but :meth:`stop` may come from another while a call hangs.
    """

    name: str
    """The name under which the driver is registered."""

    real_time: bool = True
    """Whether the rig's clock runs as fast as ours; that of a simulated or recorded rig runs at any speed."""

    @property
    @abstractmethod
    def description(self) -> Description:
        """The rig: limits, geometry, sensor. Known before connecting."""

    @property
    @abstractmethod
    def period_s(self) -> float:
        """Time between two states [s], on the rig's clock."""

    @abstractmethod
    def connect(self) -> None:
        """Connect to the rig, which stays where it is: a hand holds its present angles.

        Raises:
            WorkError: the rig does not respond.
        """

    @abstractmethod
    def observe(self) -> State:
        """Wait for the next state and return it. A simulated rig advances by one period."""

    @abstractmethod
    def act(self, command: Command, /) -> None:
        """Send a command; return without waiting for its effect."""

    @abstractmethod
    def stop(self) -> None:
        """Stop the rig, with no more force than it exerts now.

        May be called twice, at any time, and from any thread.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the rig. May be called twice."""


class HandDriver(Driver[HandDescription, HandState, HandCommand]):
    """A hand, and a context manager that connects it, stops it and releases it."""

    follows_commands: bool = True
    """Whether the hand follows commands; one that plays a recording does not."""

    def object_position_m(self) -> FloatArray | None:
        """Return the true position of the object between the fingers, in patch coordinates of the sensor (2,) [m].

        None if the hand cannot see it, as most hands cannot.
        """
        return None

    def __enter__(self) -> Self:
        """Connect."""
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the hand, whatever happened, and release it."""
        try:
            self.stop()
        finally:
            self.close()


@dataclass(frozen=True, eq=False)
class StageDescription:
    """Description of a stage with its sensor.

    Attributes:
        name: name of the rig.
        meta: metadata of its datasets: sensor, surface (a plane), indenter, mount, position.
        lower_m: smallest x, y, z of the indenter's tip (3,), in the frame of the dataset [m].
        upper_m: largest x, y, z (3,) [m].
        max_speed_m_per_s: largest commanded speed of the tip [m/s].
        max_force_n: largest allowed reading of the load cell [N].
    """

    name: str
    meta: DatasetMeta
    lower_m: FloatArray
    upper_m: FloatArray
    max_speed_m_per_s: float
    max_force_n: float


@dataclass(frozen=True, eq=False)
class StageState:
    """State of a stage at one moment.

    Attributes:
        time_s: clock of the stage [s]; it never goes back.
        position_m: measured position of the indenter's tip (3,), in the frame of the dataset [m].
        force_n: reading of the load cell along the normal, positive when pressing [N].
        taxels: taxel values (rows * cols,), flat index r * cols + c; NaN for a taxel that does not respond.
    """

    time_s: float
    position_m: FloatArray
    force_n: float
    taxels: FloatArray


class StageDriver(Driver[StageDescription, StageState, FloatArray]):
    """A stage: an indenter that is moved over a sensor on a bench, with a load cell.

    A command is the next position of the indenter's tip (3,) [m].
    """
