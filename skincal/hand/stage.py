"""The driver interface of a stage: an indenter that is moved over a sensor on a bench, with a load cell.

A rig without joints: the position of the indenter's tip and its force are measured directly. A driver moves values
between the stage and these types; the guard (:mod:`skincal.hand.stage_guard`) has limits and time-outs.
"""

from __future__ import annotations

from dataclasses import dataclass

from skincal.dataset import DatasetMeta
from skincal.hand.driver import Driver
from skincal.model.arrays import FloatArray


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
    """A stage; a command is the next position of the indenter's tip (3,) [m]."""
