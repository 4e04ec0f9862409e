"""A run as files: a session that ``dataset show`` plots and ``replay`` plays; ``deploy.json``, for `rescale`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray

from skincal.bounded import parse_json, read_text
from skincal.dataset import HOLD, IDLE, Dataset, Frames, IndenterSpec, Presses, write_dataset
from skincal.dataset.dataset import layout_of, pose_of, surface_of
from skincal.dataset.findings import Findings
from skincal.dataset.keys import Key, Word
from skincal.dataset.schema import Table, read_table
from skincal.dataset.schema_errors import Violation
from skincal.errors import input_error, quoted
from skincal.files import check_input, reason
from skincal.hand.driver import HandState
from skincal.model.arrays import FloatArray
from skincal.robot.description import JOINT_FIELDS, joint_columns
from skincal.tasks import Task

if TYPE_CHECKING:
    from skincal.deploy.handover import Motion, PinchForces
    from skincal.deploy.policy_run import Deployed
    from skincal.robot import HandDescription


@dataclass(frozen=True, eq=False, kw_only=True)
class Record:
    """States of a run, and positions of the object.

    Attributes:
        states: the T states of the hand.
        phases: (T,) phase of each state.
        places_m: (T, 2) true position of the object on the sensor [m]; NaN if unknown.
        acting: index of the state at which the policy began.
        rest_counts: (J,) rest levels of the taxels [counts].
        grip_n: (T,) normal force on the object from joint torques, mean of both fingers, zero or more [N].
    """

    states: tuple[HandState, ...]
    phases: tuple[str, ...]
    places_m: FloatArray
    acting: int
    rest_counts: FloatArray
    grip_n: FloatArray

    @classmethod
    def of(cls, motion: Motion, acting: int, forces: PinchForces) -> Record:
        """Return the record of a motion so far."""
        # An interrupt may have come while the last state was stored; the list of samples is extended last.
        states, count = tuple(motion.samples), len(motion.samples)
        normal = np.array([np.mean(forces.normal_n(state)) for state in states])
        return cls(
            states=states, phases=tuple(motion.phases[:count]), places_m=np.array(motion.places_m[:count]),
            acting=acting, rest_counts=motion.rest_counts, grip_n=np.maximum(normal, 0.0),
        )  # fmt: skip

    @property
    def is_acting(self) -> NDArray[np.bool_]:
        """(T,) True while the policy acts."""
        return np.array([phase == "acting" for phase in self.phases])

    @property
    def images_counts(self) -> FloatArray:
        """(T, J) images above rest [counts]; a taxel without a reading is 0."""
        return np.nan_to_num(np.array([state.taxels for state in self.states]) - self.rest_counts)

    @property
    def centroids_m(self) -> FloatArray:
        """(T, J) images above rest with negative values set to 0, as weights of centroids [counts]."""
        return np.maximum(self.images_counts, 0.0)


def write_record(
    record: Record, description: HandDescription, path: Path, *, radius_m: float, source: str
) -> None:
    """Write a run as a dataset with one press, which lasts while the policy acts.

    Contact points are the centroids of the images at the sensor's nominal pose, and are listed as assumed. Forces come
    from the joint torques.

    Args:
        record: record of the run.
        description: the hand.
        path: folder to create.
        radius_m: radius of the object [m].
        source: text for ``source`` in ``dataset.toml``.
    """
    meta = replace(
        description.meta,
        indenter=IndenterSpec("sphere", radius_m),
        source=source,
        created=datetime.now(UTC).replace(microsecond=0),
        assumed=("position",),
        sensor=replace(description.meta.sensor, baseline="raw"),
    )
    write_dataset(Dataset(meta, *_tables(record, description)), path)


def _tables(record: Record, description: HandDescription) -> tuple[Presses, Frames]:
    states, acting = record.states, record.is_acting
    counts = np.array([state.taxels for state in states])
    points = _points(record, description)
    columns = joint_columns(states, tuple(JOINT_FIELDS))
    columns |= {"object_u_m": record.places_m[:, 0], "object_v_m": record.places_m[:, 1]}
    frames = Frames(
        np.where(acting, 0, -1), np.where(acting, HOLD, IDLE).astype(np.int8),
        np.array([state.time_s for state in states]), np.where(acting, record.grip_n, 0.0),
        np.where(acting[:, None], points, np.nan), counts, columns=columns,
    )  # fmt: skip
    presses = Presses(
        np.array([0]),
        points[acting].mean(axis=0, keepdims=True),
        record.grip_n[acting].mean(keepdims=True),
        counts[acting].mean(axis=0, keepdims=True),
    )
    return presses, frames


def _points(record: Record, description: HandDescription) -> FloatArray:
    """Return contact points (T, 3) [m]: centroids of the images at the sensor's nominal pose."""
    meta = description.meta
    layout, surface = layout_of(meta.sensor, None), surface_of(meta.surface, {})
    images = record.centroids_m
    total = images.sum(axis=1, keepdims=True)
    uv = np.where(total > 0, images @ layout.centres_m / np.maximum(total, 1e-12), 0.0)
    return surface.wrap(pose_of(meta.mount), uv)[0]


MARKER = "deploy.json"
SESSION = "session"


@dataclass(frozen=True)
class RunOptions(Table, unknown="keep"):
    """Options of a run.

    Attributes:
        trajectory: trajectory of the marble: ``circle``, ``still``, or a CSV file.
        write: letters that the marble draws; None: it follows ``trajectory``.
        frequency_hz: frequency of the bolt's sine [Hz].
        duration_s: duration [s]; None: the task's default.
        speed_rad_per_s: joint velocity that an action of 1 commands [rad/s].
        orientation_deg: orientation of the bolt on a simulated hand [°].
    """

    trajectory: Annotated[str, Key("circle, still, or a CSV file of the working folder")]
    write: str | None
    frequency_hz: Annotated[float, Key("0.05 to 1 Hz", 0.05, 1.0)]
    duration_s: Annotated[float | None, Key("0.5 to 3600 s, or null", 0.5, 3600.0)]
    speed_rad_per_s: Annotated[float, Key("0 to 10 rad/s", 0.0, 10.0)]
    orientation_deg: Annotated[float, Key("-180° to 180°", -180.0, 180.0)]


@dataclass(frozen=True)
class RunFile(Table, unknown="keep"):
    """Data that `rescale` needs to repeat a run on simulated hands.

    Attributes:
        task: the task.
        policy: file of the policy, or the name of a bundled one.
        steps: number of steps that have passed.
        rest_counts: (J,) rest levels of the taxels [counts].
        asked: options of the run.
        finished: True if the run was not interrupted.
    """

    task: Annotated[Task, Word(options=Task)]
    policy: str
    steps: Annotated[int, Key("1 to 100000", 1, 100_000)]
    rest_counts: tuple[float, ...]
    asked: RunOptions
    finished: bool = True

    def violations(self) -> Iterator[Violation]:
        """Yield the reason if the run cannot be repeated."""
        if not self.finished:
            yield "finished", "a complete run, like the simulated ones", "one that ended early"


def read_run_file(folder: Path) -> RunFile:
    """Read ``deploy.json`` of a run's folder.

    Raises:
        InputError: the file is not an output of `deploy`, or the trajectory lies outside the working folder.
    """
    file, findings = folder / MARKER, Findings()
    expected = "the output of `skincal deploy` of this version or a later one"
    try:
        content = parse_json(read_text(file, within=folder))
        if not isinstance(content, dict):
            raise input_error(str(file), expected, type(content).__name__)
        run = read_table(RunFile, cast("dict[str, Any]", content), findings, str(file))
        findings.raise_errors()
        if run.asked.trajectory not in ("circle", "still"):
            check_input(run.asked.trajectory, within=Path.cwd())
    except (OSError, ValueError) as error:
        got = reason(error) if isinstance(error, OSError) else quoted(error)
        raise input_error(str(file), expected, got) from error
    return run


def results(run: Deployed) -> dict[str, Any]:
    """Return the results of a run for ``deploy.json``: steps, loss of the object, errors [m], times [s], force [N]."""
    error, record = run.error_m[np.isfinite(run.error_m)], run.record
    return {
        "steps": run.steps,
        "missed_steps": run.missed,
        "held": run.lost_s is None,
        "lost_s": run.lost_s,
        "error_m": float(error.mean()) if error.size else None,
        "error_settled_m": float(error[20:].mean()) if error.size > 20 else None,
        "force_n": float(record.grip_n[record.acting :].mean()),
        "period_s": float(run.period_s.mean()) if run.period_s.size else None,
        "jitter_s": run.jitter_s,
        "inference_s": float(run.inference_s.mean()),
        "rest_counts": record.rest_counts,
    }
