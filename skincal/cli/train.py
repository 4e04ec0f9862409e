"""``skincal train``: learn a policy in simulation, or an estimator of the marble's place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from skincal.cli import options
from skincal.cli.interrupt import resumable
from skincal.cli.options import argument, example, option
from skincal.cli.terminal import answer, picked, say
from skincal.errors import InputError, Problem, input_error
from skincal.tasks import OBJECTS, PUBLISHED_STEPS, TASK_PRESETS, BackendName, Engine, PolicyKind, Task

if TYPE_CHECKING:
    from skincal.ranges import Ranges
    from skincal.train import Policy, Trained
    from skincal.train.settings import Work

Learned = Literal["marble", "bolt", "pellets", "estimator"]

EPILOG = example(
    "skincal train marble --policy tactile --ranges ranges.toml --seed 1 --out run",
    "skincal train marble --out run --resume",
    "skincal train marble --from run --ranges ranges.toml --steps 50000 --out tuned",
    "skincal train estimator --ranges ranges.toml --out estimator.npz",
)

LATE_ENTROPY = 4e-4
"""Entropy coefficient of a run that continues from a policy: the published runs end with about this."""

_TASK = (
    "`marble`, `bolt`: a policy that rolls it; `pellets`: one that lets go of them one by one; `estimator`: where the "
    "marble is, from images."
)
_OUT = "Folder of the run: curve, checkpoint, policy; of an estimator its file (.npz)."
_RANGES, _SEED = "File of the randomization ranges.", "Seed of all randomness."
_STEPS = "Total steps of all environments, rounded up to whole rounds."
_PLANNED = "as planned, or 800000 for marble, 600000 for bolt, 8000000 for pellets"
_BACKEND, _ENVS = "Stable-Baselines3 (torch), or SBX (jax).", "Number of parallel environments."
_PROCESSES = "Run each environment in its own process; for many cores."
_FROM = (
    "Continue learning from an earlier run (its folder: critics and memory are taken over, too), or from a policy "
    "alone (a file, or the name of a bundled one)."
)
_START = option(_FROM, "--from", metavar="RUN|POLICY", show_default="random networks")
_RESUME = "Continue from the last checkpoint, exactly as if the run had not stopped."


def train(
    learned: Annotated[Learned, argument("TASK", _TASK, show_default=False)],
    out: Annotated[Path, option(_OUT, show_default=False)],
    policy: Annotated[PolicyKind | None, option("Observation of the policy.", show_default="tactile")] = None,
    ranges: Annotated[Path | None, option(_RANGES, show_default="preset iros24")] = None,
    seed: Annotated[int | None, option(_SEED, min=0, max=2**32 - 1, show_default="0")] = None,
    steps: Annotated[int | None, option(_STEPS, min=1, max=10**12, show_default=_PLANNED)] = None,
    backend: Annotated[BackendName | None, option(_BACKEND, show_default="sb3")] = None,
    envs: Annotated[int | None, option(_ENVS, min=1, max=4096, show_default="8; pellets 160")] = None,
    processes: Annotated[bool, option(_PROCESSES, "--processes")] = False,
    start: Annotated[str | None, _START] = None,
    engine: Annotated[Engine | None, option("Physics to learn in.", show_default="pybullet")] = None,
    resume: Annotated[bool, option(_RESUME, "--resume")] = False,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Learn a policy with the published soft actor-critic; for pellets with proximal policy optimisation.

    The run's folder holds what it is (`run.toml`, `ranges.toml`), the learning curve (`curve.csv`, in the end
    `curve.png`), the last checkpoint, and the policy as it is at that checkpoint: an ONNX file with its normalisation
    and a description, and no code.

    With `--from`, the critics alone learn for the first 6000 steps, then the policy too; its normalisation continues.
    From a policy alone the critics know too little by then: it forgets most of what it could, and learns it anew.

    An estimator finds the marble's place from one tactile image; it is learned in about a minute and needs no torch.
    """
    given = {
        "--policy": policy, "--steps": steps, "--backend": backend, "--envs": envs, "--processes": processes or None,
        "--resume": resume or None, "--from": start, "--engine": engine, "--seed": seed, "--ranges": ranges,
    }  # fmt: skip
    given = {name: value for name, value in given.items() if value is not None}
    if learned == "estimator":
        others = [name for name in given if name not in ("--seed", "--ranges")]
        _train_estimator(out, others, ranges, seed or 0, as_json=as_json, force=force)
        return
    from skincal.train import begin, policy_path, read_policy, read_run
    from skincal.train.training_run import CHECKPOINT, MARKER, POLICY

    task = Task(learned)
    if resume:
        work, used = read_run(out)
        _check_same(out, task, given, work, used)
        if not (out / CHECKPOINT).is_dir():
            say(f"{out}: no checkpoint; the run starts over at step 0")
        if not work.environment:
            say(f"{out}: an older run without the environment's numbers; it continues with today's")
    else:
        run = Path(start) if start is not None and (Path(start) / MARKER).exists() else None
        first = None if start is None else read_policy(policy_path(start if run is None else run / POLICY))
        work = _work(task, given, first)
        if run is not None:
            before, _ = read_run(run)
            _check_like(run, work, before)
            work = replace(work, settings=before.settings)
        inputs = ranges, None if first is None else first.file
        begin(work, _ranges(task, ranges), out, *inputs, start=first, run=run, force=force)
        work, used = read_run(out)
    _report(_trained(out, work, used, steps or work.steps, processes=processes), as_json)


def _work(task: Task, given: dict[str, Any], first: Policy | None) -> Work:
    from skincal.train.settings import PpoSettings, Settings, Work

    settings = PpoSettings() if task is Task.pellets else Settings()
    if "--envs" in given:
        settings = replace(settings, environments=given["--envs"])
    if first is not None and isinstance(settings, Settings):
        settings = replace(settings, entropy_coefficient=LATE_ENTROPY)
    work = Work(
        task, given.get("--policy", PolicyKind.tactile), given.get("--seed", 0),
        given.get("--steps", PUBLISHED_STEPS[task]), given.get("--backend", BackendName.sb3), settings,
        environment={"engine": str(given["--engine"])} if "--engine" in given else {},
    )  # fmt: skip
    # A round of proximal policy optimisation is as long as many of the others.
    return replace(work, rounds_per_checkpoint=1) if task is Task.pellets else work


def _check_like(run: Path, work: Work, before: Work) -> None:
    """Check that a run can take over the memory of another one: of the same library, in as many environments."""
    for name, own, other in (
        ("--backend", work.backend, before.backend),
        ("--envs", work.settings.environments, before.settings.environments),
    ):
        if own != other:
            raise input_error(f"{run}, {name}", f"{other}, with which that run was made", str(own))


def _ranges(task: Task, file: Path | None) -> Ranges:
    from skincal.envs.drawing import ranges_for

    return ranges_for(OBJECTS[task], file or TASK_PRESETS[task])


def _check_same(out: Path, task: Task, given: dict[str, Any], work: Work, used: Ranges) -> None:
    """Check that the options of a resumed run agree with those it was started with."""
    from skincal.ranges import read_ranges

    was = {
        "--policy": work.policy, "--seed": work.seed, "--backend": work.backend, "--envs": work.settings.environments,
        "--from": work.start, "--engine": work.environment.get("engine", "pybullet"),
    }  # fmt: skip
    found = [
        Problem(f"{out}, {name}", f"{was[name]}, with which the run began", f"{value}", "Leave it out.")
        for name, value in given.items()
        if name in was and was[name] != (Path(value).stem if name == "--from" else value)
    ]
    if work.task != task:
        found.append(Problem(str(out), f"a run of {task.value}", f"one of {work.task}"))
    if "--ranges" in given and read_ranges(given["--ranges"]) != used:
        fix = "Leave --ranges out, or start a separate run."
        found.append(Problem(f"{out}, --ranges", "the ranges with which the run began", "others", fix))
    if found:
        raise InputError(found)


def _trained(out: Path, work: Work, ranges: Ranges, steps: int, *, processes: bool) -> Trained:
    from skincal.cli.live import training_shown
    from skincal.report.evaluation import curves_figure
    from skincal.report.style import save_whole
    from skincal.train import maker, read_curve, train
    from skincal.train.settings import Settings
    from skincal.train.training_run import CHECKPOINT

    if isinstance(work.settings, Settings) and steps <= work.settings.learning_starts:
        first = work.settings.learning_starts
        say(
            f"skincal: warning: --steps {steps}: the policy begins to learn after {first} steps, so it stays untrained"
        )
    again = f"Continue from the last checkpoint with\n  skincal train {work.task} --out {out} --steps {steps} --resume"
    nothing = (
        f"There is no checkpoint yet, so nothing learned is saved; {out} has the run's description alone."
    )
    kept = out / CHECKPOINT
    with resumable(lambda: again if kept.is_dir() else "", nothing), training_shown(steps) as progress:
        done = train(out, maker(work, ranges), steps, processes=processes, progress=progress)
    about = done.description
    figure = curves_figure({"": read_curve(out / "curve.csv")}, f"{about.task}, {about.policy}")
    save_whole(figure, out / "curve.png", force=True)
    return done


def _report(done: Trained, as_json: bool) -> None:
    about, last = done.description, done.last
    content = {
        "run": done.folder,
        "policy": done.policy,
        "task": str(about.task),
        "kind": str(about.policy),
        **picked(about, "seed steps backend wall_time_s"),
        "last_reward": None if last is None else last.reward,
        "last_error_m": None if last is None else last.error_m,
    }
    took = f"{about.wall_time_s:.0f} s" if about.wall_time_s < 120 else f"{about.wall_time_s / 60:.0f} min"
    answer(
        as_json,
        content,
        f"{done.policy}: {about.task}, {about.policy}, {about.steps} steps in {took}; "
        f"now: skincal eval {about.task} {done.policy}",
    )


def _train_estimator(
    out: Path, others: list[str], ranges: Path | None, seed: int, *, as_json: bool, force: bool
) -> None:
    """Draw hands from the ranges, learn, and write a file of plain numbers."""
    from skincal.envs.drawing import ranges_for
    from skincal.envs.pinch import read_pinch
    from skincal.files import refuse_existing
    from skincal.progress import stage_bars
    from skincal.train.estimator import FORMAT, write_estimator
    from skincal.train.estimator_run import train_estimator

    if others:
        expected = "--out, --ranges, --seed, --force and --json alone"
        raise input_error("train estimator", expected, ", ".join(others))
    if out.suffix != ".npz":
        raise input_error(f"--out {out}", "a file that ends in .npz, for an estimator", out.name)
    refuse_existing(out, ranges, force=force, mark=FORMAT)
    with stage_bars() as progress:
        found = train_estimator(ranges_for("marble", ranges), read_pinch(None), seed=seed, progress=progress)
    write_estimator(found, out, force=force)
    quality = found.quality
    content = {
        "estimator": out,
        "images": quality.images,
        "error_median_m": quality.median_m,
        "error_p95_m": quality.p95_m,
        "centroid_error_median_m": quality.centroid_median_m,
    }
    answer(
        as_json,
        content,
        f"{out}: on held-out hands, inside the patch: median error {1e3 * quality.median_m:.2f} mm, 95 % below "
        f"{1e3 * quality.p95_m:.2f} mm (centroids of the images: median {1e3 * quality.centroid_median_m:.2f} mm); "
        f"now: skincal deploy marble POLICY --estimator {out}",
    )
