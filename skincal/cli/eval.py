"""``skincal eval``: the published evaluation of policies, side by side."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from skincal.cli import options
from skincal.cli.options import argument, example, numbers_by_name, option
from skincal.cli.terminal import answer, picked, plain, table, warn
from skincal.errors import input_error
from skincal.progress import stage_bars
from skincal.tasks import JOINT_OFFSETS, OBJECTS, Task

if TYPE_CHECKING:
    from rich.table import Table

    from skincal.ranges import Ranges
    from skincal.report.evaluation import Evaluated
    from skincal.train import Policy
    from skincal.train.evaluate import Trial


class Engine(StrEnum):
    """On what policies are tried."""

    pybullet = "pybullet"
    mujoco = "mujoco"
    reference = "reference"


EPILOG = example(
    "skincal eval marble run/policy.onnx --episodes 100 --seed 1 --out evaluation",
    "skincal eval bolt tactile.onnx desired.onnx --json",
    "skincal eval marble marble-tactile-1 --on mujoco",
    "skincal eval marble marble-tactile-1 --calibration cal",
)

MARKER = "eval.json"

_OUT = "Folder for figures and numbers; it appears complete or not at all."
_ON = "The physics, or hands with a hidden truth through their driver (marble only)."
_CALIBRATION = (
    "Predict how policies will fare on the hand of a calibration: all is drawn, the skin from its cloud."
)
_RANDOMIZE = "What to draw from the ranges: names of parameters or tables, `all` or `none`; may be repeated."
_SET = "A value of the simulation, such as `skin.y_m=0.0225`."
_ENVIRONMENT = "An option of the task, such as `solver_iterations=50`."
_TRAJECTORY = "Trajectory of the marble: `circle`, `random`, or a CSV file with u_m, v_m at 10 Hz."


def evaluate(
    task: Annotated[Task, argument(None, "Object to roll.")],
    policies: Annotated[list[str], argument("POLICY…", "Policy files, or names of bundled policies.")],
    out: Annotated[Path | None, option(_OUT)] = None,
    episodes: Annotated[int, option("Runs of each policy.", min=1, max=1_000_000)] = 100,
    seed: options.Seed = 0,
    duration_s: Annotated[
        float | None, option("Length of a run [s].", min=0.1, max=3600.0, show_default=options.DURATIONS)
    ] = None,
    on: Annotated[Engine, option(_ON)] = Engine.pybullet,
    calibration: Annotated[Path | None, option(_CALIBRATION, metavar="CAL")] = None,
    ranges: Annotated[
        Path | None, option("Ranges whose middles are the nominal values.", show_default="iros24")
    ] = None,
    randomize: Annotated[list[str] | None, option(_RANDOMIZE, show_default="finger.joint_offset_rad")] = None,
    values: Annotated[list[str] | None, option(_SET, "--set", metavar="NAME=VALUE")] = None,
    environment: Annotated[list[str] | None, option(_ENVIRONMENT, metavar="NAME=VALUE")] = None,
    trajectory: Annotated[str, option(_TRAJECTORY)] = "circle",
    gif: Annotated[
        bool, option("With --out: also write an animation of one run of each policy.", "--gif")
    ] = False,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Evaluate policies as published: joint offsets are drawn, everything else is nominal.

    With --on reference, and with --calibration, everything is drawn, and each run is on another hand.

    The marble is rolled from the centre to the side in 2 s, then round a circle of 5 mm in 6 s. The bolt is rolled for
    24 s, in four orientations by turns. All policies have the same runs.
    """
    from skincal.envs.trajectories import read_targets
    from skincal.files import refuse_existing
    from skincal.train import policy_path, read_policy
    from skincal.train.evaluate import Trial, check_task

    if gif and out is None:
        raise input_error("--gif", "--out, the folder for the film", "nothing")
    if gif and on is not Engine.pybullet:
        raise input_error("--gif", "--on pybullet", f"--on {on}")
    if out is not None:
        inputs = *map(policy_path, policies), ranges, calibration, trajectory
        refuse_existing(out, *inputs, force=force, marker=MARKER)
    if calibration is not None:
        if ranges is not None or randomize:
            given = "--ranges" if ranges is not None else "--randomize"
            raise input_error("--calibration", "neither --ranges nor --randomize", given)
        randomize = ["all"]
    drawn = {"all": None, "none": ()}
    whole = numbers_by_name("--environment", environment)
    trial = Trial(
        task,
        episodes,
        seed,
        duration_s,
        drawn[randomize[0]] if randomize in (["all"], ["none"]) else tuple(randomize or JOINT_OFFSETS),
        numbers_by_name("--set", values),
        trajectory if trajectory in ("circle", "random", "still") else read_targets(Path(trajectory)),
        {name: int(value) if value.is_integer() else value for name, value in whole.items()},
    )
    if on is Engine.reference:
        from skincal.deploy.trials import check_trial

        check_trial(trial)
    used = _ranges(task, ranges, calibration)
    loaded = [read_policy(policy_path(name)) for name in policies]
    for policy in loaded:
        check_task(policy, trial.task)
    found, predicted = _evaluated(loaded, trial, used, on), calibration is not None
    entries = [_entry(one, trial, predicted=predicted) for one in found]
    content = {"task": str(trial.task), "on": on.value, "policies": entries}
    if out is not None:
        from skincal.files import whole_folder
        from skincal.report.evaluation import write_figures, write_film, write_runs

        with whole_folder(out, force=force, marker=MARKER) as folder:
            (folder / MARKER).write_text(json.dumps(plain(content), indent=1), encoding="utf-8")
            write_runs(found, folder / "runs.csv")
            write_figures(found, trial, folder)
            for one in found if gif else ():
                write_film(one.policy, trial, folder / f"{one.name}.gif", ranges=used)
    answer(as_json, content, *([] if as_json else [_table(found, trial, predicted=predicted)]))


def _ranges(task: Task, ranges: Path | None, calibration: Path | None) -> Ranges | None:
    """Return the ranges of a file, or of a calibration with its posterior draws where it has some."""
    from skincal.envs.drawing import check_ranges, ranges_for

    if calibration is None:
        return None if ranges is None else ranges_for(OBJECTS[task], ranges)
    from skincal.calibration import read_calibration
    from skincal.ranges import from_calibration

    known = read_calibration(calibration)
    found = from_calibration(known, joint=known.draws is not None)
    warn((*known.warnings, *found.warnings))
    check_ranges(found, OBJECTS[task], str(calibration))
    return found


def _evaluated(policies: list[Policy], trial: Trial, ranges: Ranges | None, on: Engine) -> list[Evaluated]:
    import numpy as np

    from skincal.deploy.trials import run_trial
    from skincal.report.evaluation import Evaluated, names_of
    from skincal.train.scores import score

    found: list[Evaluated] = []
    with stage_bars() as progress:
        for name, policy in zip(names_of(policies), policies, strict=True):
            progress(name, 0, trial.episodes)
            runs = run_trial(
                on.value, policy, trial, ranges, lambda done, n=name: progress(n, done, trial.episodes)
            )
            found.append(Evaluated(name, policy, runs, score(runs, np.random.default_rng(trial.seed))))
    return found


def _entry(one: Evaluated, trial: Trial, *, predicted: bool) -> dict[str, Any]:
    from skincal.train.scores import fare, rolling

    names = "episodes drops time_s error_m error_settled_m error_end_m success error_low_m error_high_m"
    entry: dict[str, Any] = {
        "file": one.policy.file,
        "policy": str(one.policy.description.policy),
        **picked(one.score, f"{names} error_settled_interval_m reward"),
        "time_s": [round(float(t), 6) for t in one.score.time_s],
    }
    if predicted:
        entry["prediction"] = asdict(fare(one.runs))
    if trial.task is Task.bolt:
        own = "direction_right held_to_end held_s angle_error_rad"
        whole = rolling(one.runs)
        entry |= picked(whole, own)
        parts = whole.by_orientation_deg.items()
        entry["by_orientation_deg"] = {angle: picked(part, f"{own} drops episodes") for angle, part in parts}
    return entry


def _table(found: list[Evaluated], trial: Trial, *, predicted: bool) -> Table:
    from rich.markup import escape

    from skincal.train.scores import fare, rolling

    bolt = trial.task is Task.bolt
    titles = [
        "policy",
        "sees",
        "held",
        "error [mm]\nsettled",
        "at the\nend",
        *(["right\nway", "angle\n[°]"] * bolt),
    ]
    titles += ["will be held", "error [mm]\non your hand"] if predicted else []
    rows: list[list[str]] = []
    for one in found:
        score = one.score
        row = [
            escape(one.name),
            str(one.policy.description.policy),
            f"{score.episodes - score.drops} of {score.episodes}",
            f"{1e3 * score.error_settled_m:.2f} ({_span_mm(score.error_settled_interval_m)})",
            f"{1e3 * score.error_end_m:.2f}",
        ]
        if bolt:
            whole = rolling(one.runs)
            row += [f"{whole.direction_right:.0%}", f"{57.29578 * whole.angle_error_rad:.1f}"]
        if predicted:
            own = fare(one.runs)
            least, most = own.success_interval
            row += [f"{least:.0%} … {most:.0%}", f"{_span_mm(own.error_interval_m)} ({own.level:.0%})"]
        rows.append(row)
    return table(map(escape, titles), rows, right=True)


def _span_mm(ends_m: Iterable[float]) -> str:
    low, high = (1e3 * end for end in ends_m)
    return f"{low:.2f} … {high:.2f}" if low <= high else "–"
