"""What a stage is to skincal: an indenter that is moved over a sensor on a bench, with a load cell behind it.

A rig without joints: where the indenter's tip is and how hard it presses are measured as they are. A driver moves
values between the stage and these types; limits and time-outs are ours (:mod:`skincal.hand.stage_guard`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.dataset import DatasetMeta

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StageDescription:
    """A stage with its sensor.

    Attributes:
        name: of the rig.
        meta: what a dataset of it says of sensor, surface (a plane), indenter, mount, position.
        lower_m: least x, y, z of the indenter's tip (3,), in the frame of the dataset [m].
        upper_m: greatest (3,) [m].
        max_speed_m_per_s: the tip is commanded to go no faster [m/s].
        max_force_n: the load cell must never read more [N].
    """

    name: str
    meta: DatasetMeta
    lower_m: FloatArray
    upper_m: FloatArray
    max_speed_m_per_s: float
    max_force_n: float


@dataclass(frozen=True, eq=False)
class StageState:
    """What a stage says of itself at one moment.

    Attributes:
        time_s: clock of the stage [s]; it never goes back.
        position_m: measured place of the indenter's tip (3,), in the frame of the dataset [m].
        force_n: what the load cell reads along the normal, positive when pressing [N].
        taxels: taxel values (rows * cols,), flat index r * cols + c; NaN where a taxel does not answer.
    """

    time_s: float
    position_m: FloatArray
    force_n: float
    taxels: FloatArray


class StageDriver(ABC):
    """A stage: it is observed, and told where the indenter's tip shall be next.

    ``state = stage.observe(); stage.act(position)``, once every :attr:`period_s`. Calls come from one thread, but
    :meth:`stop` may come from another.
    """

    name: str
    """The name under which the driver is registered."""

    real_time: bool = True
    """Whether the clock of the stage runs as fast as ours; that of a simulated one does not."""

    @property
    @abstractmethod
    def description(self) -> StageDescription:
        """The rig; known before connecting."""

    @property
    @abstractmethod
    def period_s(self) -> float:
        """Time between two states [s]."""

    @abstractmethod
    def connect(self) -> None:
        """Takes the stage; it stays where it is.

        Raises:
            WorkError: it does not answer.
        """

    @abstractmethod
    def observe(self) -> StageState:
        """Waits for the next state and returns it."""

    @abstractmethod
    def act(self, position_m: FloatArray) -> None:
        """Sets where the indenter's tip shall be (3,) [m]; returns without waiting."""

    @abstractmethod
    def stop(self) -> None:
        """Brings the stage to a halt. May be called twice, at any time, and from any thread."""

    @abstractmethod
    def close(self) -> None:
        """Gives the stage back. May be called twice."""
