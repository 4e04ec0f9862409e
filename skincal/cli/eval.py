"""``skincal eval``: the published evaluation of policies, side by side."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from skincal.cli.common import ForceOption, JsonOption, SeedOption, example, print_json
from skincal.cli.eval_report import as_json, table_of
from skincal.errors import InputError, Problem
from skincal.progress import progress
from skincal.train.settings import Task

if TYPE_CHECKING:
    from collections.abc import Callable

    from skincal.ranges import Ranges
    from skincal.report.evaluation import Evaluated
    from skincal.train import Policy
    from skincal.train.evaluate import Trial
    from skincal.train.scores import Runs


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


def evaluate(
    task: Annotated[Task, typer.Argument(help="Object to roll.")],
    policies: Annotated[
        list[str],
        typer.Argument(metavar="POLICY…", help="Policy files, or names of bundled policies."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for figures and numbers; it appears complete or not at all."),
    ] = None,
    episodes: Annotated[
        int, typer.Option("--episodes", min=1, max=1_000_000, help="Runs of each policy.")
    ] = 100,
    seed: SeedOption = 0,
    duration_s: Annotated[
        float | None,
        typer.Option(
            "--duration-s", min=0.1, max=3600.0, help="Length of a run [s].", show_default="8 marble, 24 bolt"
        ),
    ] = None,
    on: Annotated[
        Engine,
        typer.Option(
            "--on", help="The physics, or hands with a hidden truth through their driver (marble only)."
        ),
    ] = Engine.pybullet,
    calibration: Annotated[
        Path | None,
        typer.Option(
            "--calibration",
            metavar="CAL",
            help="Predict how policies will fare on the hand of a calibration: all is drawn, the skin from its cloud.",
        ),
    ] = None,
    ranges: Annotated[
        Path | None,
        typer.Option("--ranges", help="Ranges whose middles are the nominal values.", show_default="iros24"),
    ] = None,
    randomize: Annotated[
        list[str] | None,
        typer.Option(
            "--randomize",
            help="What to draw from the ranges: names of parameters or tables, `all` or `none`; may be repeated.",
            show_default="finger.joint_offset_rad",
        ),
    ] = None,
    values: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="A value of the simulation, such as `skin.y_m=0.0225`."
        ),
    ] = None,
    environment: Annotated[
        list[str] | None,
        typer.Option(
            "--environment",
            metavar="NAME=VALUE",
            help="An option of the task, such as `solver_iterations=50`.",
        ),
    ] = None,
    trajectory: Annotated[
        str,
        typer.Option(
            "--trajectory",
            help="Trajectory of the marble: `circle`, `random`, or a CSV file with u_m, v_m at 10 Hz.",
        ),
    ] = "circle",
    gif: Annotated[
        bool, typer.Option("--gif", help="With --out: also write an animation of one run of each policy.")
    ] = False,
    to_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Evaluate policies as published: joint offsets are drawn, everything else is nominal.

    With --on reference, and with --calibration, everything is drawn, and each run is on another hand.

    The marble is rolled from the centre to the side in 2 s, then round a circle of 5 mm in 6 s. The bolt is rolled for
    24 s, in four orientations by turns. All policies have the same runs.
    """
    from skincal.files import refuse_existing
    from skincal.train import policy_path, read_policy
    from skincal.train.evaluate import check_task

    if gif and out is None:
        raise InputError([Problem("--gif", "--out, the folder for the film", "nothing")])
    if gif and on is not Engine.pybullet:
        raise InputError([Problem("--gif", "--on pybullet", f"--on {on}")])
    if out is not None:
        inputs = (ranges, calibration, Path(trajectory))
        files = [policy_path(name) for name in policies] + [one for one in inputs if one]
        refuse_existing(out, *files, force=force, marker=MARKER)
    if calibration is not None:
        if ranges is not None or randomize:
            given = "--ranges" if ranges is not None else "--randomize"
            raise InputError([Problem("--calibration", "neither --ranges nor --randomize beside it", given)])
        randomize = ["all"]
    trial = _trial(task, episodes, seed, duration_s, randomize, values or [], trajectory, environment or [])
    if on is Engine.reference:
        from skincal.deploy.trials import check_trial

        check_trial(trial)
    used = _ranges(task, ranges, calibration)
    loaded = [read_policy(policy_path(name)) for name in policies]
    for policy in loaded:
        check_task(policy, trial.task)
    found = _evaluated(loaded, trial, used, on)
    content = as_json(found, trial, on=on.value, predicted=calibration is not None)
    if out is not None:
        _write(found, trial, used, content, out, gif=gif, force=force)
    if to_json:
        print_json(content)
        return
    from rich.console import Console

    Console().print(table_of(found, trial, predicted=calibration is not None))


MARKER = "eval.json"


def _trial(
    task: Task,
    episodes: int,
    seed: int,
    duration_s: float | None,
    randomize: list[str] | None,
    values: list[str],
    trajectory: str,
    environment: list[str],
) -> Trial:
    from skincal.train.evaluate import RANDOMIZED, Trial

    drawn: tuple[str, ...] | None = RANDOMIZED if not randomize else tuple(randomize)
    if drawn in (("all",), ("none",)):
        drawn = None if drawn == ("all",) else ()
    return Trial(
        task,
        episodes,
        seed,
        duration_s,
        drawn,
        dict(_assignment("--set", text) for text in values),
        trajectory if trajectory in ("circle", "random", "still") else _targets(Path(trajectory)),
        {name: _whole(value) for name, value in (_assignment("--environment", text) for text in environment)},
    )


def _assignment(option: str, text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise InputError([Problem(option, "NAME=VALUE with a number", repr(text))]) from None


def _whole(value: float) -> float:
    """Return a whole number as an int, for options that are counts."""
    return int(value) if value.is_integer() else value


MOST_M = 0.5
"""Largest distance of a target from the middle of a skin [m]."""


def _targets(path: Path) -> list[list[float]]:
    """Return the trajectory of a file."""
    from skincal.bounded import parse_csv, read_text
    from skincal.files import reason

    try:
        header, *rows = parse_csv(read_text(path)) or [[]]
        u, v = (header.index(name) for name in ("u_m", "v_m"))
        targets = [[float(row[u]), float(row[v])] for row in rows if row]
        if beyond := [x for target in targets for x in target if not abs(x) <= MOST_M]:
            raise ValueError(f"a target at {beyond[0]:g} m; no skin is larger than {MOST_M:g} m")
        if not targets:
            raise ValueError("no rows")
        return targets
    except (OSError, ValueError, IndexError) as error:
        got = reason(error) if isinstance(error, OSError) else f"{error}"
        expected = "circle, random, still, or a CSV file with the columns u_m and v_m [m]"
        raise InputError([Problem(f"--trajectory {path}", expected, got)]) from error


def _ranges(task: Task, ranges: Path | None, calibration: Path | None) -> Ranges | None:
    """Ranges of a file, or of a calibration with its cloud of draws where it has one."""
    from skincal.envs.needed import check_ranges, ranges_for

    kind: Literal["marble", "bolt"] = "bolt" if task is Task.bolt else "marble"  # pellets are small spheres
    if calibration is None:
        return None if ranges is None else ranges_for(kind, ranges)
    from skincal.calibration import read_calibration
    from skincal.cli.common import warn
    from skincal.ranges import from_calibration

    known = read_calibration(calibration)
    found = from_calibration(known, joint=known.draws is not None)
    warn((*known.warnings, *found.warnings))
    check_ranges(found, kind, str(calibration))
    return found


def _evaluated(policies: list[Policy], trial: Trial, ranges: Ranges | None, on: Engine) -> list[Evaluated]:
    import numpy as np

    from skincal.report.evaluation import Evaluated, names_of
    from skincal.train.scores import score

    found: list[Evaluated] = []
    with progress() as bars:
        for name, policy in zip(names_of(policies), policies, strict=True):
            task = bars.add_task(name, total=trial.episodes)
            runs = _runs(policy, trial, ranges, on, lambda n, t=task: bars.update(t, completed=n))
            found.append(Evaluated(name, policy, runs, score(runs, np.random.default_rng(trial.seed))))
    return found


def _runs(
    policy: Policy, trial: Trial, ranges: Ranges | None, on: Engine, told: Callable[[int], None]
) -> Runs:
    from skincal.train.evaluate import environment_for, evaluate

    if on is Engine.reference:
        from skincal.deploy.trials import reference_runs

        return reference_runs(policy, trial, ranges=ranges or "iros24", told=told)
    environment = environment_for(policy, trial, ranges, engine=on.value)
    try:
        return evaluate(policy, environment, trial, told=told)
    finally:
        environment.close()


def _write(
    found: list[Evaluated],
    trial: Trial,
    ranges: Ranges | None,
    content: dict[str, Any],
    out: Path,
    *,
    gif: bool,
    force: bool,
) -> None:
    import json

    from skincal.cli.common import plain
    from skincal.files import whole_folder
    from skincal.report.evaluation import write_figures, write_runs

    with whole_folder(out, force=force, marker=MARKER) as temporary:
        (temporary / MARKER).write_text(json.dumps(plain(content), indent=1), encoding="utf-8")
        write_runs(found, temporary / "runs.csv")
        write_figures(found, trial, temporary)
        if gif:
            from skincal.report.film import write_film

            for one in found:
                write_film(one.policy, trial, temporary / f"{one.name}.gif", ranges=ranges)
