"""Requests of a session, and its reports while it runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from skincal.collect.plan import PlannedPress
from skincal.collect.senses import Sample
from skincal.hand import HandDriver, StageDriver, StageState


@dataclass(frozen=True)
class Need:
    """State of a session for which a driver is created.

    Attributes:
        session_s: time at which the session's clock continues [s]; 0 at the start.
        indenter_radius_m: radius of the indenter to mount [m]; None: the rig's own.
    """

    session_s: float = 0.0
    indenter_radius_m: float | None = None
    connections: int = 0


@dataclass(frozen=True, eq=False)
class StageSample:
    """A state of a stage.

    Attributes:
        force_n: normal force without the reading at rest [N].
        phase: phase of the press, by the code of the dataset.
    """

    time_s: float
    force_n: float
    state: StageState
    phase: int


@dataclass(frozen=True, eq=False)
class Progress:
    """Progress of a session."""

    done: int
    total: int
    planned: PlannedPress
    doing: str
    sample: Sample | StageSample


MakeDriver = Callable[[Need], HandDriver | StageDriver]
Watch = Callable[[Progress], None]
