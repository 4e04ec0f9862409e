"""Options and results of a run on a hand: ``deploy.json``, which `rescale` reads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np

from skincal.bounded import parse_json, read_text
from skincal.dataset.findings import Findings
from skincal.dataset.keys import Key, Word
from skincal.dataset.schema import Table, read_table
from skincal.dataset.schema_errors import Violation
from skincal.deploy.policy_run import Deployed
from skincal.errors import input_error, quoted
from skincal.files import check_input, reason
from skincal.tasks import Task

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
