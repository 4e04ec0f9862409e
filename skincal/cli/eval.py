"""``skincal eval``: the published evaluation of policies, side by side."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.common import ForceOption, JsonOption, SeedOption, example, print_json
from skincal.errors import InputError, Problem
from skincal.progress import progress

if TYPE_CHECKING:
    from rich.table import Table

    from skincal.report.evaluation import Evaluated
    from skincal.train import Policy
    from skincal.train.evaluate import Trial


class Task(StrEnum):
    """The tasks, listed here so that help need not import them."""

    marble = "marble"
    bolt = "bolt"


EPILOG = example(
    "skincal eval marble run/policy.onnx --episodes 100 --seed 1 --out evaluation",
    "skincal eval bolt tactile.onnx desired.onnx --json",
)


def evaluate(
    task: Annotated[Task, typer.Argument(help="Object to roll.", show_default=False)],
    policies: Annotated[
        list[str],
        typer.Argument(
            metavar="POLICY…", help="Policy files, or names of bundled policies.", show_default=False
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for figures and numbers; it appears complete or not at all."),
    ] = None,
    episodes: Annotated[int, typer.Option("--episodes", min=1, help="Runs of each policy.")] = 100,
    seed: SeedOption = 0,
    duration_s: Annotated[
        float | None,
        typer.Option("--duration-s", min=0.1, help="Length of a run [s].", show_default="8 marble, 24 bolt"),
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
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Evaluate policies as published: joint offsets are drawn, everything else is nominal.

    The marble rolls from the centre to the side in 2 s, then round a circle of 5 mm in 6 s. The bolt rolls for 24 s, in
    four orientations in turn. All policies get the same runs.
    """
    from skincal.files import refuse_existing
    from skincal.train import policy_path, read_policy
    from skincal.train.evaluate import check_task

    if gif and out is None:
        raise InputError([Problem("--gif", "--out, the folder for the film", "nothing")])
    if out is not None:
        files = [policy_path(name) for name in policies] + [one for one in (ranges, Path(trajectory)) if one]
        refuse_existing(out, *files, force=force, marker=MARKER)
    trial = _trial(task, episodes, seed, duration_s, randomize, values or [], trajectory, environment or [])
    loaded = [read_policy(policy_path(name)) for name in policies]
    for policy in loaded:
        check_task(policy, trial.task)
    found = _evaluated(loaded, trial, ranges)
    content = _as_json(found, trial)
    if out is not None:
        _write(found, trial, ranges, content, out, gif=gif, force=force)
    if as_json:
        print_json(content)
        return
    from rich.console import Console

    Console().print(_table(found, trial))


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
    from skincal.train import Task as TrainTask
    from skincal.train.evaluate import RANDOMIZED, Trial

    drawn: tuple[str, ...] | None = RANDOMIZED if not randomize else tuple(randomize)
    if drawn in (("all",), ("none",)):
        drawn = None if drawn == ("all",) else ()
    return Trial(
        TrainTask(task.value),
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
"""A target lies no further from the middle of a skin [m]."""


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


def _evaluated(policies: list[Policy], trial: Trial, ranges: Path | None) -> list[Evaluated]:
    import numpy as np

    from skincal.envs.needed import ranges_for
    from skincal.report.evaluation import Evaluated, names_of
    from skincal.train.evaluate import environment_for, evaluate
    from skincal.train.scores import score

    used = None if ranges is None else ranges_for(trial.task.value, ranges)
    found: list[Evaluated] = []
    with progress() as bars:
        for name, policy in zip(names_of(policies), policies, strict=True):
            task = bars.add_task(name, total=trial.episodes)
            environment = environment_for(policy, trial, used)
            try:
                runs = evaluate(
                    policy, environment, trial, told=lambda n, t=task: bars.update(t, completed=n)
                )
            finally:
                environment.close()
            found.append(Evaluated(name, policy, runs, score(runs, np.random.default_rng(trial.seed))))
    return found


def _write(
    found: list[Evaluated],
    trial: Trial,
    ranges: Path | None,
    content: dict[str, Any],
    out: Path,
    *,
    gif: bool,
    force: bool,
) -> None:
    import json

    from skincal.cli.common import plain
    from skincal.files import whole_folder
    from skincal.ranges import read_ranges
    from skincal.report.evaluation import write_figures, write_runs

    with whole_folder(out, force=force, marker=MARKER) as temporary:
        (temporary / MARKER).write_text(json.dumps(plain(content), indent=1), encoding="utf-8")
        write_runs(found, temporary / "runs.csv")
        write_figures(found, trial, temporary)
        if gif:
            from skincal.report.film import write_film

            used = None if ranges is None else read_ranges(ranges)
            for one in found:
                write_film(one.policy, trial, temporary / f"{one.name}.gif", ranges=used)


def _as_json(found: list[Evaluated], trial: Trial) -> dict[str, Any]:
    """Return the contract's content, with further figures."""
    return {"task": str(trial.task), "policies": [_entry(one, trial) for one in found]}


def _entry(one: Evaluated, trial: Trial) -> dict[str, Any]:
    from skincal.train import Task as TrainTask
    from skincal.train.scores import rolling

    score = one.score
    entry: dict[str, Any] = {
        "file": one.policy.file,
        "policy": str(one.policy.description.policy),
        "episodes": score.episodes,
        "drops": score.drops,
        "time_s": [round(float(t), 6) for t in score.time_s],
        "error_m": score.error_m,
        "error_settled_m": score.error_settled_m,
        "error_end_m": score.error_end_m,
        "success": score.success,
        "error_low_m": score.error_low_m,
        "error_high_m": score.error_high_m,
        "error_settled_interval_m": score.error_settled_interval_m,
        "reward": score.reward,
    }
    if trial.task is TrainTask.bolt:
        whole = rolling(one.runs)
        entry |= {"direction_right": whole.direction_right, "held_to_end": whole.held_to_end}
        entry |= {"held_s": whole.held_s, "angle_error_rad": whole.angle_error_rad}
        entry["by_orientation_deg"] = {
            name: {
                "direction_right": part.direction_right,
                "held_to_end": part.held_to_end,
                "drops": part.drops,
                "episodes": part.episodes,
                "held_s": part.held_s,
                "angle_error_rad": part.angle_error_rad,
            }
            for name, part in whole.by_orientation_deg.items()
        }
    return entry


def _table(found: list[Evaluated], trial: Trial) -> Table:
    from rich.markup import escape
    from rich.table import Table

    from skincal.train import Task as TrainTask
    from skincal.train.scores import rolling

    bolt = trial.task is TrainTask.bolt
    titles = ["policy", "sees", "held", "error settled [mm]", "at the end [mm]"]
    table = Table(box=None, padding=(0, 2, 0, 0))
    for title in [*titles, *(["direction right", "angle error [°]"] if bolt else [])]:
        table.add_column(escape(title))
    for one in found:
        score = one.score
        low, high = (1e3 * end for end in score.error_settled_interval_m)
        row = [
            escape(one.name),
            str(one.policy.description.policy),
            f"{score.episodes - score.drops} of {score.episodes}",
            f"{1e3 * score.error_settled_m:.2f} ({low:.2f} … {high:.2f})",
            f"{1e3 * score.error_end_m:.2f}",
        ]
        if bolt:
            whole = rolling(one.runs)
            row += [f"{whole.direction_right:.0%}", f"{57.29578 * whole.angle_error_rad:.1f}"]
        table.add_row(*row)
    return table
