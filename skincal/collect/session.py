"""A session of presses on any rig: what is still to do, its clock, its journal and its progress."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.collect.journal import Arrays, Journal
from skincal.collect.plan import CollectOptions, Plan, PlannedPress
from skincal.collect.press import Moments
from skincal.collect.senses import Sample
from skincal.covariates import TARGET, TIMES
from skincal.dataset import IDLE
from skincal.hand import HandDriver, StageDriver, StageState
from skincal.model.arrays import FloatArray


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


PAUSE_S = 1.0
"""Gap in the session's clock when a session continues on another clock [s]."""


class Session:
    """The presses of a plan that a journal does not have yet, and what is stored of them.

    Attributes:
        todo: numbers of the missing presses, in order.
        last_frame_s: time of the last stored frame, session clock [s]; -inf without one.
        cycles: earlier touches of each press's site, including those by interrupted presses.
    """

    def __init__(self, plan: Plan, journal: Journal, options: CollectOptions, watch: Watch | None) -> None:
        self.plan, self.journal, self.options, self._watch = plan, journal, options, watch
        self.todo, self.last_frame_s = journal.open_end(len(plan))
        connections = journal.connections()
        # An earlier connection for the press that now comes first may have touched its site.
        self._resumed = bool(connections)
        cuts = [int(connection["first"]) for connection in connections if connection["resumed"]]
        self.cycles = _touches(plan, [*cuts, *(self.todo[:1] if self._resumed else ())])

    def need(self, indenter_radius_m: float | None = None) -> Need:
        """Return what the driver of the next connection is made for."""
        return Need(max(self.last_frame_s, 0.0), indenter_radius_m, len(self.journal.connections()))

    def connect(self, rig_s: float) -> float:
        """Record a connection, before the rig moves.

        The session's clock goes on with the rig's if that ran on, else a moment after the last frame.

        Args:
            rig_s: the rig's clock now [s].

        Returns:
            Difference of the session's clock from the rig's [s].
        """
        shift_s = -rig_s
        if np.isfinite(self.last_frame_s):
            shifts = [float(connection["shift_s"]) for connection in self.journal.connections()]
            shift_s = max([*shifts[-1:], self.last_frame_s + PAUSE_S - rig_s])
        self.journal.connected({"first": self.todo[0], "resumed": self._resumed, "shift_s": shift_s})
        self._resumed = False
        return shift_s

    def press_row(
        self, number: int, target_m: FloatArray, moments: Moments, means: Mapping[str, float]
    ) -> dict[str, Any]:
        """Return what the row of a press holds on every rig, by column.

        Args:
            number: number of the press.
            target_m: planned contact point (3,) [m].
            moments: starts of the parts of the press.
            means: means over the steady part of the hold, by column; among them ``force_n``.
        """
        planned, options = self.plan.presses[number], self.options
        tolerance_n = max(options.tolerance_n, options.tolerance_share * planned.force_n)
        return {
            "press": number,
            **means,
            **dict(zip(TIMES, astuple(moments), strict=True)),
            **dict(zip(TARGET, target_m, strict=True)),
            "target_force_n": planned.force_n,
            "speed_m_per_s": planned.speed_m_per_s,
            "pose": planned.pose,
            "cycle": self.cycles[number],
            "kind": planned.kind,
            "missed_target": int(abs(means["force_n"] - planned.force_n) > tolerance_n),
        }

    def phase_columns(self, phase: NDArray[Any], number: int = -1) -> dict[str, NDArray[Any]]:
        """Return the columns of frames (M,) that say which press they belong to; idle ones belong to none."""
        touched = phase != IDLE
        planned, cycle = self.plan.presses[number], float(self.cycles[number])
        return {
            "phase": phase,
            "press": np.where(touched, number, -1),
            "cycle": np.where(touched, cycle, np.nan),
            "speed_m_per_s": np.where(touched, planned.speed_m_per_s, np.nan),
        }

    def keep(self, number: int, row: Mapping[str, Any], frames: Mapping[str, Any]) -> None:
        """Store a finished press, its row and its frames; on return it is on the disk."""
        arrays = _named("press", row) | _named("frames", frames)
        self.journal.keep_press(number, arrays)
        self.todo.remove(number)
        self._note_time(arrays)

    def keep_rest(self, frames: Mapping[str, Any], more: Mapping[str, Any] | None = None) -> None:
        """Store frames without contact, outside of presses, and more columns of them."""
        idle = self.phase_columns(np.full(len(frames["time_s"]), IDLE))
        arrays = _named("frames", {**frames, **idle, **(more or {})})
        self.journal.keep_rest(arrays)
        self._note_time(arrays)

    def report(self, sample: Sample | StageSample, doing: str) -> None:
        """Tell the progress callback of a sample."""
        if self._watch is not None:
            done, total = len(self.plan) - len(self.todo), len(self.plan)
            planned = self.plan.presses[self.todo[0] if self.todo else -1]
            self._watch(Progress(done, total, planned, doing, sample))

    def _note_time(self, arrays: Arrays) -> None:
        if len(times := arrays["frames.time_s"]):
            self.last_frame_s = float(times[-1])


def _named(table: str, columns: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Return columns by the names that they have in the journal."""
    return {f"{table}.{name}": np.asarray(column) for name, column in columns.items()}


def _touches(plan: Plan, cuts: list[int]) -> list[int]:
    """Return the earlier touches of each press's site; a press that was cut off counts as a touch."""
    cycles = list(plan.cycles())
    for cut in cuts:
        for number in range(cut, len(plan)):
            cycles[number] += plan.presses[number].site == plan.presses[cut].site
    return cycles
