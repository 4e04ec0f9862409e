"""``skincal deploy``: let a policy move an object between the fingers of a hand."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.common import ForceOption, JsonOption, OutOption, SeedOption, example, print_json, say
from skincal.cli.hand import BeyondLimitsOption, DriverOptionsOption, RigOption, find_modules_here
from skincal.cli.interrupt import moving
from skincal.train.settings import Task

if TYPE_CHECKING:
    import numpy as np

    from skincal.deploy import Deployed
    from skincal.hand.driver import HandState
    from skincal.robot import HandDescription
    from skincal.train import Policy
    from skincal.train.estimator import Estimator

EPILOG = example(
    "skincal deploy marble marble-tactile-1 --driver reference --seed 3 --out rolled",
    "skincal deploy marble policy.onnx --driver remote --driver-option address=tcp://10.0.0.4:5555 --out rolled",
    "skincal deploy marble marble-tactile-1 --write DLR --out letters",
)

MARKER = "deploy.json"
SESSION = "session"
WIDTH_MM = 12.0
"""Width of the published marble and bolt."""


ESTIMATOR = "marble-estimator-1"


def deploy(
    task: Annotated[Task, typer.Argument(help="Object to roll.")],
    policy: Annotated[
        str, typer.Argument(metavar="POLICY", help="A policy file, or the name of a bundled policy.")
    ],
    out: OutOption,
    driver: RigOption = "reference",
    driver_option: DriverOptionsOption = None,
    seed: SeedOption = 0,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            "--effect", metavar="NAME=STRENGTH", help="Effect of the reference hand's skin; may be repeated."
        ),
    ] = None,
    pinch: Annotated[
        Path | None,
        typer.Option("--hand", help="Folder with hand.toml and pinch.toml.", show_default="the bundled hand"),
    ] = None,
    trajectory: Annotated[
        str,
        typer.Option(
            "--trajectory", help="Trajectory of the marble: `circle`, `still`, or a CSV file with u_m, v_m."
        ),
    ] = "circle",
    write: Annotated[
        str | None, typer.Option("--write", help="Letters that the marble draws, such as DLR.")
    ] = None,
    frequency_hz: Annotated[
        float, typer.Option("--frequency-hz", min=0.05, max=1.0, help="Frequency of the bolt's sine.")
    ] = 0.25,
    duration_s: Annotated[
        float | None,
        typer.Option(
            "--duration-s",
            min=0.5,
            max=3600.0,
            help="Length of the run [s].",
            show_default="8 marble, 24 bolt; or the letters'",
        ),
    ] = None,
    width_mm: Annotated[
        float, typer.Option("--width-mm", min=1.0, max=40.0, help="Width of the object.")
    ] = WIDTH_MM,
    estimator: Annotated[
        str | None,
        typer.Option(
            "--estimator",
            help="Draws the way as the skin felt it: a file of `train estimator`, or one that comes along; `none`.",
            show_default=f"{ESTIMATOR}, of the marble on the bundled hand",
        ),
    ] = None,
    beyond_limits: BeyondLimitsOption = False,
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Run a policy on a hand: grasp the object, act at 10 Hz, let go.

    Put the object between the open fingers; they close until both feel it. All limits of the guard apply; any
    irregularity stops the hand. OUT holds the run as a session, which `--driver replay` plays, with a picture.
    """
    from skincal.deploy import deploy as run
    from skincal.deploy import write_record
    from skincal.envs.pinch import read_pinch
    from skincal.files import refuse_existing, whole_folder
    from skincal.hand import GuardOptions
    from skincal.hand.registry import create_driver
    from skincal.train import policy_path, read_policy

    find_modules_here(driver)
    file = Path(policy_path(policy))
    inputs = [one for one in (file, pinch, Path(trajectory)) if one is not None and one.exists()]
    refuse_existing(out, *inputs, force=force, marker=MARKER)
    chosen = read_policy(file)
    _check_task(chosen.description.task, task, policy)
    targets = targets_of(task, trajectory, write, frequency_hz, duration_s)
    options = _driver_options(driver, driver_option, seed, effect, task, pinch)
    made = create_driver(driver, **options)
    hand, width = read_pinch(pinch), 1e-3 * width_mm
    speed = _speed(chosen, task, float(hand.description.limits.velocity_rad_per_s.min()))
    guard = GuardOptions(beyond_limits=beyond_limits)
    places = _estimator(task, estimator, pinch, hand.description)
    with _progress(hand.description) as watch, moving():
        found = run(
            chosen, made, hand, targets, object_width_m=width, speed_rad_per_s=speed, guard=guard, watch=watch
        )
    content = _as_json(found, task, chosen.file, driver, seed, out)
    content["asked"] = {
        "trajectory": trajectory,
        "write": write,
        "frequency_hz": frequency_hz,
        "duration_s": duration_s,
        "speed_rad_per_s": speed,
        "orientation_deg": float(options.get("orientation_deg", 0.0)),
    }
    felt = None
    if places is not None:
        from skincal.deploy.estimate import estimate_error_m, estimated_places

        felt = estimated_places(found.record, places, hand, width)
        content["estimate_error_median_m"] = estimate_error_m(found.record, felt)
    with whole_folder(out, force=force, marker=MARKER) as folder:
        source = f"skincal deploy {task}: policy {Path(chosen.file).name}, driver {driver}, seed {seed}"
        write_record(found.record, hand.description, folder / SESSION, radius_m=width / 2, source=source)
        _write_records(found, hand.description, content, folder, felt)
    if as_json:
        print_json(content)
        return
    _tell(content)


_SPEEDS = {"marble": 0.3, "bolt": 0.6}
"""Joint velocity that an action of 1 commands in the tasks [rad/s]."""


def _speed(policy: Policy, task: Task, most: float) -> float:
    """Return the joint velocity of an action of 1 [rad/s]: the policy's own, if the hand allows it."""
    from skincal.errors import InputError, Problem

    speed = policy.description.environment.get("speed_rad_per_s", _SPEEDS[task])
    if isinstance(speed, str) or not 0 < speed <= most:
        expected = f"a policy of joints from 0 to {most:g} rad/s, as the hand has"
        raise InputError([Problem(policy.file, expected, f"one of {speed} rad/s")])
    return float(speed)


def _check_task(made_for: str, task: Task, policy: str) -> None:
    from skincal.errors import InputError, Problem

    if str(made_for) != task.value:
        fix = f"skincal deploy {made_for} {policy}"
        raise InputError([Problem(policy, f"a policy for {task.value}", f"one for {made_for}", fix)])


def targets_of(
    task: Task, trajectory: str, write: str | None, frequency_hz: float, duration_s: float | None
) -> np.ndarray:
    """Return where the object shall go, as the verb was asked."""
    from skincal.cli.eval import _targets as targets_of_file
    from skincal.deploy import letters, marble_targets
    from skincal.deploy.deploy_options import POLICY_HZ
    from skincal.envs.trajectories import sine
    from skincal.errors import InputError, Problem

    if task is Task.bolt:
        if write is not None:
            raise InputError([Problem("--write", "the task marble", "bolt")])
        return sine(round((duration_s or 24.0) * POLICY_HZ) + 1, frequency_hz)
    if write is not None:
        way = letters(write)
        return way if duration_s is None else marble_targets(way, duration_s)
    known = trajectory in ("circle", "still")
    return marble_targets(trajectory if known else targets_of_file(Path(trajectory)), duration_s or 8.0)


def _driver_options(
    driver: str,
    given: list[str] | None,
    seed: int,
    effect: list[str] | None,
    task: Task,
    pinch: Path | None,
) -> dict[str, Any]:
    """Return the driver's options; this command's own options go only to drivers that have them."""
    from skincal.cli.collect import _effects
    from skincal.errors import InputError, Problem
    from skincal.hand.registry import driver_options, parse_options

    known = {option.name for option in driver_options(driver)}
    options: dict[str, Any] = dict(parse_options(given or []))
    if effect and "effects" not in known:
        raise InputError([Problem("--effect", "a simulated hand, such as --driver reference", driver)])
    own = {"seed": seed, "effects": _effects(effect) or None, "task": task.value, "hand": pinch}
    return options | {n: v for n, v in own.items() if n in known and n not in options and v is not None}


@contextmanager
def _progress(hand: HandDescription) -> Generator[Callable[[HandState, str], None]]:
    """Yield a callback that shows the stage, time and tactile image on a terminal, else one line per stage."""
    import time

    from rich.console import Console, Group
    from rich.live import Live
    from rich.text import Text

    from skincal.cli.collect_progress import EVERY_S, taxel_image

    console = Console(stderr=True)
    stage, drawn = "", 0.0
    with (
        Live(console=console, transient=True, auto_refresh=False)
        if console.is_terminal
        else _nothing() as live
    ):

        def watch(state: HandState, doing: str) -> None:
            nonlocal stage, drawn
            if live is None:
                if doing != stage:
                    say(f"{state.time_s:7.2f} s  {doing}")
                stage = doing
                return
            now = time.monotonic()
            if now - drawn > EVERY_S:
                drawn = now
                image = taxel_image(state.taxels, hand.meta.sensor)
                live.update(Group(Text(f"{doing:12s} {state.time_s:7.2f} s"), image), refresh=True)

        yield watch


@contextmanager
def _nothing() -> Generator[None]:
    yield None


def _estimator(task: Task, name: str | None, pinch: Path | None, hand: HandDescription) -> Estimator | None:
    from skincal.errors import InputError, Problem
    from skincal.train.bundled import estimator_path
    from skincal.train.estimator import read_estimator

    if task is Task.bolt and name not in (None, "none"):
        raise InputError([Problem("--estimator", "the task marble", "bolt")])
    if name == "none" or task is Task.bolt or (name is None and pinch is not None):
        return None
    found, taxels = read_estimator(estimator_path(name or ESTIMATOR)), hand.meta.sensor.taxels
    if found.taxels != taxels:
        fix = "It is for another sensor; train one for this hand."
        raise InputError([Problem(f"--estimator {name}", f"{taxels} taxels", str(found.taxels), fix)])
    return found


def _write_records(
    found: Deployed, hand: HandDescription, content: dict[str, Any], folder: Path, felt: np.ndarray | None
) -> None:
    import json

    from skincal.cli.common import plain
    from skincal.dataset.model_objects import layout_of
    from skincal.report.deploy import deploy_figure
    from skincal.report.style import save

    (folder / MARKER).write_text(json.dumps(plain(content), indent=1) + "\n", encoding="utf-8")
    save(deploy_figure(found, layout_of(hand.meta.sensor, None), felt_m=felt), folder / "run.png")


def _as_json(found: Deployed, task: Task, policy: str, driver: str, seed: int, out: Path) -> dict[str, Any]:
    import numpy as np

    error = found.error_m[np.isfinite(found.error_m)]
    return {
        "task": task.value,
        "policy": policy,
        "driver": driver,
        "seed": seed,
        "steps": found.steps,
        "missed_steps": found.missed,
        "held": found.lost_s is None,
        "lost_s": found.lost_s,
        "error_m": float(error.mean()) if error.size else None,
        "error_settled_m": float(error[20:].mean()) if error.size > 20 else None,
        "force_n": float(found.record.force_n[found.record.acting :].mean()),
        "period_s": float(found.period_s.mean()) if found.period_s.size else None,
        "jitter_s": found.jitter_s,
        "inference_s": float(found.inference_s.mean()),
        "rest_counts": found.record.rest_counts,
        "session": str(out / SESSION),
    }


def _tell(content: dict[str, Any]) -> None:
    held = "held to the end" if content["held"] else f"lost after {content['lost_s']:.1f} s"
    error = content["error_m"]
    known = "" if error is None else f", tracking error {1e3 * error:.2f} mm"
    typer.echo(
        f"{content['task']}: {content['steps']} steps, {held}{known}; period {1e3 * content['period_s']:.1f} ms, "
        f"jitter {1e3 * content['jitter_s']:.2f} ms"
    )
    typer.echo(f"session: {content['session']}")
