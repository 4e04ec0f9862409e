"""``skincal train``: learn a policy in simulation."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.common import ForceOption, JsonOption, example, print_json, say
from skincal.cli.interrupt import Ended
from skincal.errors import InputError, Problem

if TYPE_CHECKING:
    from skincal.ranges import Ranges
    from skincal.train import Trained, Work


class Task(StrEnum):
    """The tasks, listed here so that help need not import them."""

    marble = "marble"
    bolt = "bolt"
    pellets = "pellets"


class Learned(StrEnum):
    """What can be learned."""

    marble = "marble"
    bolt = "bolt"
    pellets = "pellets"
    estimator = "estimator"


class Kind(StrEnum):
    """The kinds of policies."""

    tactile = "tactile"
    joint_angles = "joint-angles"
    desired = "desired"
    ideal = "ideal"


class Engine(StrEnum):
    """The physics engines."""

    pybullet = "pybullet"
    mujoco = "mujoco"


class Backend(StrEnum):
    """The training backends."""

    sb3 = "sb3"
    sbx = "sbx"


EPILOG = example(
    "skincal train marble --policy tactile --ranges ranges.toml --seed 1 --out run",
    "skincal train marble --out run --resume",
    "skincal train marble --from marble-tactile-1 --ranges ranges.toml --steps 50000 --out tuned",
    "skincal train estimator --ranges ranges.toml --out estimator.npz",
)

LATE_ENTROPY = 4e-4
"""Entropy coefficient of a run that goes on from a policy: with about this the published runs end."""

STEPS = {Task.marble: 800_000, Task.bolt: 600_000, Task.pellets: 8_000_000}


def train(
    learned: Annotated[
        Learned,
        typer.Argument(
            metavar="TASK",
            help="`marble`, `bolt`: a policy that rolls it; `pellets`: one that lets go of them one by one; "
            "`estimator`: where the marble is, from images.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            help="Folder of the run: curve, checkpoint, policy; of an estimator its file (.npz).",
            show_default=False,
        ),
    ],
    policy: Annotated[
        Kind | None, typer.Option("--policy", help="Observation of the policy.", show_default="tactile")
    ] = None,
    ranges: Annotated[
        Path | None,
        typer.Option("--ranges", help="File of the randomization ranges.", show_default="preset iros24"),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option("--seed", min=0, max=2**32 - 1, help="Seed of all randomness.", show_default="0"),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps",
            min=1,
            help="Total steps of all environments, rounded up to whole rounds.",
            show_default="as planned, or 800000 for marble, 600000 for bolt, 8000000 for pellets",
        ),
    ] = None,
    backend: Annotated[
        Backend | None,
        typer.Option("--backend", help="Stable-Baselines3 (torch), or SBX (jax).", show_default="sb3"),
    ] = None,
    envs: Annotated[
        int | None,
        typer.Option("--envs", min=1, help="Number of parallel environments.", show_default="8; pellets 160"),
    ] = None,
    processes: Annotated[
        bool,
        typer.Option("--processes", help="Run each environment in its own process; for many cores."),
    ] = False,
    start: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="POLICY",
            help="Continue learning from this policy (a file, or the name of a bundled one).",
            show_default="random networks",
        ),
    ] = None,
    engine: Annotated[
        Engine | None, typer.Option("--engine", help="Physics to learn in.", show_default="pybullet")
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume", help="Continue from the last checkpoint, exactly as if the run had not stopped."
        ),
    ] = False,
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Learn a policy with the published soft actor-critic; for pellets with proximal policy optimisation.

    The run's folder holds what it is (`run.toml`, `ranges.toml`), the learning curve (`curve.csv`, in the end
    `curve.png`), the last checkpoint, and the policy as it is at that checkpoint: an ONNX file with its normalisation
    and a description, and no code.

    With `--from`, the critics alone learn for the first 6000 steps, then the policy too; its normalisation goes on.

    An estimator tells the marble's place from one tactile image; it is learned in about a minute and needs no torch.
    """
    if learned is Learned.estimator:
        from skincal.cli.train_estimator import train_estimator

        flags = {"--policy": policy, "--steps": steps, "--backend": backend, "--envs": envs}
        flags |= {"--processes": processes or None, "--resume": resume or None}
        flags |= {"--from": start, "--engine": engine}
        others = {name: value for name, value in flags.items() if value is not None}
        train_estimator(out, others, ranges, seed, as_json=as_json, force=force)
        return
    task = Task(learned.value)
    given = {"policy": policy, "ranges": ranges, "seed": seed, "backend": backend, "envs": envs}
    given |= {"from": start, "engine": engine}
    stated = {f"--{name}": value for name, value in given.items() if value is not None}
    from dataclasses import replace

    from skincal.train import PpoSettings, Settings, begin, policy_path, read_policy, read_run
    from skincal.train.training_run import CHECKPOINT

    if resume:
        work, used = read_run(out)
        _same(out, task, stated, work, used)
        if not (out / CHECKPOINT).is_dir():
            say(f"{out}: no checkpoint; the run starts over at step 0")
        if not work.environment:
            say(f"{out}: an older run without the environment's numbers; it continues with today's")
    else:
        first = None if start is None else read_policy(policy_path(start))
        settings = PpoSettings() if task is Task.pellets else Settings()
        if envs is not None:
            settings = replace(settings, environments=envs)
        if first is not None and isinstance(settings, Settings):
            settings = replace(settings, entropy_coefficient=LATE_ENTROPY)
        work = _work(task, policy, seed, steps or STEPS[task], backend, settings)
        if engine is not None:
            work = replace(work, environment={"engine": engine.value})
        used = _ranges(task, ranges)
        inputs = [ranges] if ranges is not None else []
        inputs += [Path(first.file)] if first is not None else []
        begin(work, used, out, *inputs, start=first, force=force)
        work, used = read_run(out)
    result = _train(out, work, used, steps or work.steps, processes=processes)
    _draw(result)
    if as_json:
        print_json(_as_json(result))
    else:
        typer.echo(_summary(result))


def _work(
    task: Task, policy: Kind | None, seed: int | None, steps: int, backend: Backend | None, settings: Any
) -> Work:
    from dataclasses import replace

    from skincal.train import BackendName, PolicyKind, Work
    from skincal.train import Task as TrainTask

    work = Work(
        TrainTask(task.value),
        PolicyKind((policy or Kind.tactile).value),
        seed or 0,
        steps,
        BackendName((backend or Backend.sb3).value),
        settings,
    )
    # A round of proximal policy optimisation is as long as many of the others.
    return replace(work, rounds_per_checkpoint=1) if task is Task.pellets else work


def _ranges(task: Task, file: Path | None) -> Ranges:
    """Return the ranges of a file, or the task's own; errors name the file."""
    from skincal.envs.needed import ranges_for

    if task is Task.pellets:
        return ranges_for("marble", file or "icra26")
    return ranges_for(task.value, file)


def _same(out: Path, task: Task, stated: dict[str, Any], work: Work, used: Ranges) -> None:
    """Check that the options of a resumed run agree with those it was started with."""
    from skincal.ranges import read_ranges

    was = {"--policy": str(work.policy), "--seed": work.seed, "--backend": str(work.backend)}
    was["--envs"] = work.settings.environments
    was["--from"], was["--engine"] = work.start, work.environment.get("engine", "pybullet")
    found = [
        Problem(f"{out}, {name}", f"{was[name]}, with which the run began", f"{value}", "Leave it out.")
        for name, value in stated.items()
        if name in was and was[name] != (Path(value).stem if name == "--from" else value)
    ]
    if str(work.task) != task.value:
        found.append(Problem(str(out), f"a run of {task.value}", f"one of {work.task}"))
    if "--ranges" in stated and read_ranges(stated["--ranges"]) != used:
        fix = "Leave --ranges out, or start a separate run."
        found.append(Problem(f"{out}, --ranges", "the ranges with which the run began", "others", fix))
    if found:
        raise InputError(found)


def _train(out: Path, work: Work, ranges: Ranges, steps: int, *, processes: bool) -> Trained:
    from skincal.cli.train_progress import Told
    from skincal.train import maker, train

    try:
        with Told(steps) as reporter:
            return train(out, maker(work, ranges), steps, processes=processes, told=reporter)
    except KeyboardInterrupt:
        say(
            f"skincal: interrupted; continue from the last checkpoint with\n"
            f"  skincal train {work.task} --out {out} --steps {steps} --resume"
        )
        raise Ended(130) from None


def _draw(result: Trained) -> None:
    """Draw the learning curve next to its figures."""
    from skincal.files import whole_file
    from skincal.report.style import save
    from skincal.report.train_curve import curves_figure
    from skincal.train import read_curve

    about = result.description
    figure = curves_figure({"": read_curve(result.folder / "curve.csv")}, f"{about.task}, {about.policy}")
    with whole_file(result.folder / "curve.png", force=True) as temporary:
        save(figure, temporary)


def _as_json(result: Trained) -> dict[str, Any]:
    about, last = result.description, result.last
    return {
        "run": result.folder,
        "policy": result.policy,
        "task": str(about.task),
        "kind": str(about.policy),
        "seed": about.seed,
        "steps": about.steps,
        "backend": about.backend,
        "wall_time_s": about.wall_time_s,
        "last_reward": None if last is None else last.reward,
        "last_error_m": None if last is None else last.error_m,
    }


def _summary(result: Trained) -> str:
    about = result.description
    return (
        f"{result.policy}: {about.task}, {about.policy}, {about.steps} steps in {about.wall_time_s / 60:.0f} min; "
        f"now: skincal eval {about.task} {result.policy}"
    )
