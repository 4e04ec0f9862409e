"""From a plan and a rig to a dataset: start or resume a session, and write the dataset when it is complete."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.bounded import parse_toml, read_text
from skincal.collect.connection import press_on_hand
from skincal.collect.journal import Journal, digest_of, journal_folder, journal_lock
from skincal.collect.plan import CollectOptions, Plan
from skincal.collect.plan_file import plan_as_toml, read_plan
from skincal.collect.poses import with_poses
from skincal.collect.posture import Fingers, Mount
from skincal.collect.record import dataset_of, rest_shifts
from skincal.collect.session import MakeDriver, Session, Watch
from skincal.collect.stage import check_height, press_on_stage
from skincal.dataset import Dataset, DatasetMeta, check_dataset, write_dataset
from skincal.errors import InputError, Problem, input_error
from skincal.files import alone, recover, refuse_existing
from skincal.hand import GuardOptions, StageDescription
from skincal.robot import HandDescription, Kinematics
from skincal.robot.description import values_of

MARKER = "dataset.toml"
PLAN = "plan.toml"


@dataclass(frozen=True, eq=False)
class Collected:
    """A completed session.

    Attributes:
        dataset: the dataset as written.
        resumed: number of presses from an interrupted session.
        session_s: length of the session on its clock [s].
        interruptions: number of resumptions.
        problems: reasons why the dataset cannot be used; empty: it can.
        rest_shifts: presses after which taxels rest at another level.
    """

    dataset: Dataset
    resumed: int
    session_s: float
    interruptions: int
    problems: tuple[Problem, ...] = ()
    rest_shifts: tuple[Problem, ...] = ()

    @property
    def missed_target(self) -> int:
        """Number of presses whose force is off its target by more than the tolerance."""
        return int(np.sum(self._column("missed_target")))

    @property
    def statuses(self) -> dict[str, int]:
        """Number of presses by status."""
        names, counts = np.unique(self._column("status").astype(str), return_counts=True)
        return {str(name): int(count) for name, count in zip(names, counts, strict=True)}

    def _column(self, name: str) -> NDArray[Any]:
        column = self.dataset.presses.column(name)
        assert column is not None
        return column


def collect(
    plan: Plan,
    rig: HandDescription | StageDescription,
    make_driver: MakeDriver,
    out: Path,
    *,
    key: Mapping[str, Any] | None = None,
    options: CollectOptions | None = None,
    guard: GuardOptions | None = None,
    source: str = "",
    force: bool = False,
    inputs: Sequence[Path] = (),
    restart: bool = False,
    watch: Watch | None = None,
) -> Collected:
    """Make the presses of a plan and write the dataset.

    Every finished press is stored in a folder next to ``out`` (``.NAME.collect``) until the dataset is written. Called
    again after an interruption of any kind, the session resumes with the press that was not finished.

    Args:
        plan: the plan; for a stage, from ``skincal.collect.stage.stage_plan``.
        rig: the hand, or the stage.
        make_driver: creates a driver for every connection.
        out: folder of the dataset; created when the session is complete.
        key: further values that must be equal to resume a session: driver, seed, options.
        options: options of the presses.
        guard: limits of the guard; None: its defaults.
        source: for ``dataset.toml``.
        force: whether to replace an existing dataset.
        inputs: input files, which must not be replaced.
        restart: whether to discard an interrupted session.
        watch: progress callback, called in every period.

    Raises:
        InputError: the plan cannot be carried out, ``out`` exists, or another session was interrupted.
        HandError: the hand or stage failed; call again to resume.
        WorkError: a press cannot be made.
    """
    options = options or CollectOptions()
    same = {"plan": plan_digest(plan), **(key or {}), "options": digest_of(repr(asdict(options)))}
    if isinstance(rig, StageDescription):
        check_height(rig, options.clearance_m)
    same["stage" if isinstance(rig, StageDescription) else "hand"] = rig_digest(rig)
    folder = journal_folder(out)
    if not _written(folder, out):
        refuse_existing(out, *inputs, force=force, marker=MARKER)
    with alone(journal_lock(out), folder, create=True):
        recover(out)
        journal = Journal.open(folder, same, {"created": datetime.now(UTC).isoformat()}, restart=restart)
        resumed = _sound_presses(journal, rig.meta)
        try:
            if isinstance(rig, StageDescription):
                press_on_stage(Session(plan, journal, options, watch), make_driver, guard)
            else:
                fingers = Fingers(Kinematics(rig), Mount.of(rig.meta))
                resolved = _resolved(plan, journal, fingers, options)
                press_on_hand(Session(resolved, journal, options, watch), fingers, make_driver, guard)
        except BaseException:
            if not journal.connections():  # The rig was never reached.
                journal.remove()
            raise
        dataset = dataset_of(journal, rig.meta, source, datetime.fromisoformat(journal.head["created"]))
        if not _written(folder, out):
            write_dataset(dataset, out, force=force)
        problems = check_dataset(out).errors
        assert dataset.frames is not None
        times = dataset.frames.time_s
        cuts = sum(bool(connection["resumed"]) for connection in journal.connections())
        journal.remove()
    session_s = float(times[-1] - times[0])
    return Collected(dataset, resumed, session_s, cuts, problems, rest_shifts(dataset))


def _sound_presses(journal: Journal, meta: DatasetMeta) -> int:
    """Return the number of finished presses; refuse files that have been changed, before the rig is connected."""
    numbers = list(journal.presses())
    if not numbers:
        return 0
    try:
        data = dataset_of(journal, meta, "", datetime.fromisoformat(journal.head["created"]))
        tables = (data.presses, data.frames)
        taxels = {table.counts.shape[1:] for table in tables if table is not None}
        good = taxels == {(meta.sensor.taxels,)} and sorted(numbers) == sorted(data.presses.press.tolist())
    except (ArithmeticError, LookupError, TypeError, ValueError):
        good = False
    if not good:
        fix = "Add --restart to start over; it removes the folder."
        expected, got = "finished presses as they were stored", "files that have been changed"
        raise input_error(str(journal.folder), expected, got, fix)
    return len(numbers)


def plan_digest(plan: Plan) -> str:
    """Return the name, length and digest of a plan, by which a session recognises it."""
    return f"{plan.name}, {len(plan)} presses ({digest_of(plan_as_toml(plan))})"


def rig_digest(rig: HandDescription | StageDescription) -> str:
    """Return the name and digest of all that describes a hand or stage, by which a session recognises it."""
    return f"{rig.name} ({digest_of(repr(values_of(rig)))})"


def _resolved(plan: Plan, journal: Journal, fingers: Fingers, options: CollectOptions) -> Plan:
    """Return the plan with the angles of its poses, which are searched once and stored."""
    path = journal.folder / PLAN
    if path.is_file():
        return with_poses(replace(plan, poses=read_plan(path, fingers.mount).poses), fingers, options)
    plan = with_poses(plan, fingers, options)
    journal.keep_text(PLAN, plan_as_toml(plan))
    return plan


def _written(folder: Path, out: Path) -> bool:
    """Return whether ``out`` is the dataset of this session, interrupted before the journal was removed."""
    try:
        journal = Journal.find(folder)
        created = parse_toml(read_text(out / MARKER))["created"]
        return journal is not None and created == datetime.fromisoformat(journal.head["created"])
    except (OSError, InputError, KeyError, ValueError):
        return False
