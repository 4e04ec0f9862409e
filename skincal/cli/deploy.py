"""``skincal deploy``: let a policy move an object between the fingers of a hand."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Annotated, Any

from skincal.cli import options
from skincal.cli.interrupt import moving
from skincal.cli.options import argument, example, numbers_by_name, option, options_named
from skincal.cli.terminal import answer, plain
from skincal.errors import input_error
from skincal.tasks import SPEEDS_RAD_PER_S, Task

if TYPE_CHECKING:
    import numpy as np

    from skincal.deploy import Deployed
    from skincal.robot import HandDescription
    from skincal.train import Policy
    from skincal.train.estimator import Estimator

EPILOG = example(
    "skincal deploy marble marble-tactile-1 --driver reference --seed 3 --out rolled",
    "skincal deploy marble policy.onnx --driver remote --driver-option address=tcp://10.0.0.4:5555 --out rolled",
    "skincal deploy marble marble-tactile-1 --write DLR --out letters",
)

WIDTH_MM = 12.0
"""Width of the published marble and bolt."""

ESTIMATOR = "marble-estimator-1"

_PICTURE_BYTES, _OTHER_COLUMNS, _GRASP_S, _MOST_HZ = 4 << 20, 10, 30.0, 200
"""Room that is kept for a run: picture and numbers [bytes], columns besides four of each joint and the taxels, time to
grasp and to let go [s], states a second: twice those of the simulated hands; a faster one may need more room."""

_PINCH = "Folder with hand.toml and pinch.toml."
_TRAJECTORY = "Trajectory of the marble: `circle`, `still`, or a CSV file with u_m, v_m."
_LENGTH = f"{options.DURATIONS}; or the letters'"
_DURATION = option("Length of the run [s].", min=0.5, max=3600.0, show_default=_LENGTH)
_DRAWS = "Draws the way as the skin felt it: a file of `train estimator`, or one that comes along; `none`."
_ESTIMATOR = option(_DRAWS, show_default=f"{ESTIMATOR}, of the marble on the bundled hand")


def deploy(
    task: Annotated[Task, argument(None, "Object to roll.")],
    policy: Annotated[str, argument("POLICY", "A policy file, or the name of a bundled policy.")],
    out: options.Out,
    driver: options.Driver = "reference",
    driver_option: options.DriverOptions = None,
    seed: options.Seed = 0,
    effect: options.Effects = None,
    pinch: Annotated[Path | None, option(_PINCH, "--hand", show_default="the bundled hand")] = None,
    trajectory: Annotated[str, option(_TRAJECTORY)] = "circle",
    write: Annotated[str | None, option("Letters that the marble draws, such as DLR.")] = None,
    frequency_hz: Annotated[float, option("Frequency of the bolt's sine.", min=0.05, max=1.0)] = 0.25,
    duration_s: Annotated[float | None, _DURATION] = None,
    width_mm: Annotated[float, option("Width of the object.", min=1.0, max=40.0)] = WIDTH_MM,
    estimator: Annotated[str | None, _ESTIMATOR] = None,
    beyond_limits: options.BeyondLimits = False,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Run a policy on a hand: grasp the object, act at 10 Hz, let go.

    Put the object between the open fingers; they close until both feel it. All limits of the guard apply; any
    irregularity stops the hand. OUT holds the run as a session, which `--driver replay` plays, with a picture.
    """
    from skincal.cli.live import RunProgress
    from skincal.dataset.dataset import layout_of
    from skincal.deploy import deploy as run
    from skincal.deploy import targets_of, write_record
    from skincal.deploy.estimate import estimate_error_m, estimate_positions
    from skincal.deploy.record import MARKER, SESSION, results
    from skincal.envs.pinch import read_pinch
    from skincal.files import refuse_existing, reserved_room, whole_folder
    from skincal.hand import GuardOptions
    from skincal.hand.registry import create_driver
    from skincal.train import policy_path, read_policy

    file = Path(policy_path(policy))
    refuse_existing(out, file, pinch, trajectory, force=force, marker=MARKER)
    chosen = read_policy(file)
    if str(chosen.description.task) != task.value:
        fix = f"skincal deploy {chosen.description.task} {policy}"
        raise input_error(policy, f"a policy for {task.value}", f"one for {chosen.description.task}", fix)
    targets = targets_of(task, trajectory, write, frequency_hz, duration_s)
    settings = _driver_options(driver, driver_option, seed, effect, task, pinch)
    with options_named("driver"):
        made = create_driver(driver, **settings)
    hand, width = read_pinch(pinch), 1e-3 * width_mm
    sensor = hand.description.meta.sensor
    speed = _speed(chosen, task, float(hand.description.limits.velocity_rad_per_s.min()))
    guard = GuardOptions(beyond_limits=beyond_limits)
    places = _estimator(task, estimator, pinch, hand.description)
    asked = {
        "trajectory": trajectory, "write": write, "frequency_hz": frequency_hz, "duration_s": duration_s,
        "speed_rad_per_s": speed, "orientation_deg": float(settings.get("orientation_deg", 0.0)),
    }  # fmt: skip

    def keep(found: Deployed, felt: np.ndarray | None, *, finished: bool, out: Path = out) -> dict[str, Any]:
        """Write the session, the numbers and, of a run that came to its end, the picture."""
        from skincal.report.hand import deploy_figure
        from skincal.report.style import save

        content = {
            "task": task.value, "policy": chosen.file, "driver": driver, "seed": seed, "finished": finished,
            **results(found), "session": str(out / SESSION), "asked": asked,
        }  # fmt: skip
        if felt is not None:
            content["estimate_error_median_m"] = estimate_error_m(found.record, felt)
        source = f"skincal deploy {task}: policy {Path(chosen.file).name}, driver {driver}, seed {seed}"
        with whole_folder(out, force=force, marker=MARKER) as folder:
            write_record(found.record, hand.description, folder / SESSION, radius_m=width / 2, source=source)
            (folder / MARKER).write_text(json.dumps(plain(content), indent=1) + "\n", encoding="utf-8")
            if finished:
                save(deploy_figure(found, layout_of(sensor, None), felt_m=felt), folder / "run.png")
        return content

    ended: list[Callable[[], Deployed]] = []

    def saved() -> str:
        if not ended:
            return "Nothing of the run is saved."
        place = out
        give_free()
        try:
            keep(ended[0](), None, finished=False)
        except OSError:  # the disk is full, or gone
            place = Path(mkdtemp(prefix="skincal-")) / out.name
            keep(ended[0](), None, finished=False, out=place)
        return f"The run so far is saved in {place / SESSION}."

    with reserved_room(out, _size(hand.description, len(targets))) as give_free, moving(saved):
        with RunProgress(sensor) as watch:
            found = run(
                chosen, made, hand, targets, object_width_m=width, speed_rad_per_s=speed, guard=guard, watch=watch,
                cut_short=ended.append,
            )  # fmt: skip
        ended.append(lambda: found)
        give_free()
        felt = None if places is None else estimate_positions(found.record, places, hand, width)
        content = keep(found, felt, finished=True)
    held = "held to the end" if content["held"] else f"lost after {content['lost_s']:.1f} s"
    error = "" if content["error_m"] is None else f", tracking error {1e3 * content['error_m']:.2f} mm"
    period = "" if content["period_s"] is None else f"; period {1e3 * content['period_s']:.1f} ms"
    jitter = f"jitter {1e3 * found.jitter_s:.2f} ms"
    shown = f"{task.value}: {found.steps} steps, {held}{error}{period}, {jitter}"
    answer(as_json, content, shown, f"session: {content['session']}")


def _size(hand: HandDescription, targets: int) -> int:
    """Return the room that a run of so many targets may take, with its picture [bytes]."""
    from skincal.envs.trajectories import POLICY_HZ
    from skincal.robot.description import JOINT_FIELDS

    columns = len(JOINT_FIELDS) * len(hand.joints) + hand.meta.sensor.taxels + _OTHER_COLUMNS
    return _PICTURE_BYTES + int((targets / POLICY_HZ + _GRASP_S) * _MOST_HZ) * columns * 8


def _speed(policy: Policy, task: Task, most: float) -> float:
    """Return the joint velocity of an action of 1 [rad/s]: the policy's own, if the hand allows it."""
    speed = policy.description.environment.get("speed_rad_per_s", SPEEDS_RAD_PER_S[task])
    if isinstance(speed, str) or not 0 < speed <= most:
        expected = f"a policy of joints from 0 to {most:g} rad/s, as the hand has"
        raise input_error(policy.file, expected, f"one of {speed} rad/s")
    return float(speed)


def _driver_options(
    driver: str, given: list[str] | None, seed: int, effect: list[str] | None, task: Task, pinch: Path | None
) -> dict[str, Any]:
    """Return the driver's options; this command's own options go only to drivers that have them."""
    from skincal.hand.registry import driver_options, parse_options

    known = {option.name for option in driver_options(driver)}
    settings: dict[str, Any] = dict(parse_options(given or []))
    effects = numbers_by_name("--effect", effect, "NAME=STRENGTH")
    if effects and "effects" not in known:
        raise input_error("--effect", "a simulated hand, such as --driver reference", driver)
    own = {"seed": seed, "effects": effects or None, "task": task.value, "hand": pinch}
    return settings | {n: v for n, v in own.items() if n in known and n not in settings and v is not None}


def _estimator(task: Task, name: str | None, pinch: Path | None, hand: HandDescription) -> Estimator | None:
    from skincal.train.estimator import read_estimator
    from skincal.train.policy_file import estimator_path

    if task is Task.bolt and name not in (None, "none"):
        raise input_error("--estimator", "the task marble", "bolt")
    if name == "none" or task is Task.bolt or (name is None and pinch is not None):
        return None
    found, taxels = read_estimator(estimator_path(name or ESTIMATOR)), hand.meta.sensor.taxels
    if found.taxels != taxels:
        fix = "It is for another sensor; train one for this hand."
        raise input_error(f"--estimator {name}", f"{taxels} taxels", found.taxels, fix)
    return found
