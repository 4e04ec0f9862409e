"""``skincal collect``: press a hand's own skin, or a stage's, and write the presses as a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli import options
from skincal.cli.interrupt import AGAIN, moving
from skincal.cli.options import example, numbers_by_name, option, options_named
from skincal.cli.terminal import answer, say, warn
from skincal.errors import input_error
from skincal.tasks import PROTOCOLS

if TYPE_CHECKING:
    from skincal.collect import Collected, Plan
    from skincal.collect.rig import Rig
    from skincal.hand import StageDescription
    from skincal.robot import HandDescription

EPILOG = example(
    "skincal collect --driver sim --seed 7 --out run",
    "skincal collect --driver sim --effect hysteresis=1 --truth truth.json --out run --json",
)

PROTOCOL = "; ".join(f"`{name}`: {drawn}" for name, drawn in PROTOCOLS.items()) + "."
PLAN_ONLY = "Move nothing; write the plan and its picture, as OUT-plan.toml and .png."
SECOND = (
    "Radius of a second sphere: the full protocol ends with presses with it; you are asked to change the cap."
)


def collect(
    out: options.Out,
    driver: options.Driver = "sim",
    seed: options.Seed = 0,
    protocol: Annotated[str | None, option(PROTOCOL, show_default="full")] = None,
    plan: Annotated[Path | None, option("A plan of your own, TOML or CSV, instead of a protocol.")] = None,
    plan_only: Annotated[bool, option(PLAN_ONLY, "--plan-only")] = False,
    second_indenter_mm: Annotated[float | None, option(SECOND, min=0.5, max=50.0)] = None,
    effect: options.Effects = None,
    truth: Annotated[Path | None, option("File for the simulated hand's hidden truth (JSON).")] = None,
    hand: options.Hand = None,
    driver_option: options.DriverOptions = None,
    beyond_limits: options.BeyondLimits = False,
    restart: Annotated[bool, option("Discard an interrupted session and start over.", "--restart")] = False,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Press the skin with the hand's own indenter, at a regulated force, and write the dataset.

    Contact points and forces come from joint angles and torques. Every finished press is saved at once: an interrupted
    session continues when the same command is given again.
    """
    from skincal.collect import journal_folder
    from skincal.collect.rig import driver_text
    from skincal.collect.stage import stage_plan
    from skincal.files import refuse_existing
    from skincal.hand import StageDescription

    rig = rig_of(driver, seed, effect, hand, driver_option, truth, beyond_limits=beyond_limits)
    inputs = [Path(one) for one in (plan, hand) if one is not None]
    description, is_stage = rig.driver.description, rig.hand is None
    if is_stage and second_indenter_mm is not None:
        expected = "a hand's cap; a stage presses with its own indenter"
        raise input_error("--second-indenter-mm", expected, f"{second_indenter_mm:g}")
    chosen = plan_of(plan, protocol, seed, description, second_indenter_mm)
    if isinstance(description, StageDescription):
        chosen = stage_plan(chosen, description)
    if plan_only:
        _show_plan(chosen, rig.hand, out, inputs, force, as_json)
        return
    if truth is not None and not journal_folder(out).exists():
        from skincal.hand import sim, stage_sim

        mark = (stage_sim if is_stage else sim).TRUTH_FORMAT
        refuse_existing(truth, *inputs, force=force, mark=mark)
    effects = f", effects {', '.join(effect)}" if effect else ""
    kind = "stage, " if is_stage else ""
    of = f"{driver_text(driver, seed)}{effects}, plan {chosen.name}, {description.name}"
    source = f"skincal collect: {kind}{of}"
    found = press(rig, chosen, out, source, force=force, inputs=inputs, restart=restart)
    _report(found, out, as_json)


def _report(found: Collected, out: Path, as_json: bool) -> None:
    """Report a finished session; status 1 if its dataset cannot be fitted."""
    presses = len(found.dataset.presses)
    marks = ", ".join(f"{n} {name}" for name, n in found.statuses.items())
    if found.resumed and not as_json:
        say(f"{found.resumed} presses come from the interrupted session.")
    content = {
        "presses": presses,
        "missed_target": found.missed_target,
        "dataset": out,
        "status": found.statuses,
        "resumed": found.resumed,
        "session_s": round(found.session_s, 3),
        "rest_shifts": [str(shift) for shift in found.rest_shifts],
        "problems": [str(problem) for problem in found.problems],
    }
    summary = f"{presses} presses ({marks}), {found.session_s:.0f} s of the hand's time"
    answer(as_json, content, summary, f"dataset: {out}")
    warn((*found.rest_shifts, *found.problems))
    if found.problems:
        expected = "expected a dataset that can be fitted; got the problems above. Nothing is lost."
        say(f"skincal: error: {out}: {expected}")
        raise typer.Exit(1)


def rig_of(
    driver: str,
    seed: int,
    effect: list[str] | None,
    hand: str | None,
    given: list[str] | None,
    truth: Path | None = None,
    *,
    beyond_limits: bool,
) -> Rig:
    """Return the rig of a command line; its driver is not connected."""
    from skincal.collect.rig import Rig

    effects = numbers_by_name("--effect", effect, "NAME=STRENGTH")
    with options_named("driver", "effect"):
        return Rig.of(
            driver, given, seed, beyond_limits=beyond_limits, effects=effects, truth_path=truth, hand=hand
        )


def press(rig: Rig, plan: Plan, out: Path, source: str, start_s: float = 0.0, **output: Any) -> Collected:
    """Make the presses of a plan, or go on with them, with progress on the terminal."""
    from skincal.cli.live import SessionProgress

    with SessionProgress(rig.driver.description.meta.sensor) as progress, moving(lambda: saved(out)):

        def change_cap(radius_m: float | None) -> None:
            progress.pause()
            size = "the hand's own" if radius_m is None else f"{1e3 * radius_m:g} mm"
            typer.confirm(f"Mount the cap with the sphere of radius: {size}. Done?", abort=True, err=True)

        return rig.press(plan, out, source, start_s=start_s, change_cap=change_cap, watch=progress, **output)


def saved(out: Path) -> str:
    """Return a sentence about the presses of a session that ended early."""
    from skincal.collect import journal_folder

    folder = journal_folder(out)
    done = len(list(folder.glob("press-*.npz")))
    return f"{done} finished presses are saved in {folder}; {AGAIN}." if done else "No press was finished."


def plan_of(
    path: Path | None,
    protocol: str | None,
    seed: int,
    description: HandDescription | StageDescription,
    second_mm: float | None,
) -> Plan:
    """Return the plan of a file, or of a protocol drawn by the seed (``full`` by default)."""
    import numpy as np

    from skincal.collect import PROTOCOLS, Mount, read_plan

    mount = Mount.of(description.meta)
    if path is not None and protocol is not None:
        got = f"--protocol {protocol} and --plan {path}"
        fix = "A plan lists all presses; leave one of the two options out."
        raise input_error("--protocol", "a protocol or a plan of your own", got, fix)
    if path is not None:
        if second_mm is not None:
            raise input_error("--second-indenter-mm", "the full protocol", path)
        return read_plan(path, mount)
    protocol = protocol or "full"
    if protocol not in PROTOCOLS:
        raise input_error("--protocol", f"one of {', '.join(PROTOCOLS)}", f'"{protocol}"')
    rng = np.random.default_rng([seed, len(protocol)])
    second_m = None if second_mm is None else second_mm * 1e-3
    return PROTOCOLS[protocol](rng, mount.layout, second_indenter_m=second_m)


def _show_plan(
    plan: Plan, hand: HandDescription | None, out: Path, inputs: Sequence[Path], force: bool, as_json: bool
) -> None:
    """Write a plan and, for a hand, its poses and its picture; print a summary."""
    from skincal.collect import KINDS, CollectOptions, write_plan
    from skincal.collect.plan_file import FORMAT
    from skincal.files import refuse_existing

    file, picture = (out.with_name(f"{out.name}-plan{suffix}") for suffix in (".toml", ".png"))
    refuse_existing(file, *inputs, force=force, mark=FORMAT)
    if hand is None:
        write_plan(plan, file, force=force)
        answer(as_json, {"presses": len(plan), "plan": file}, f"plan: {file}")
        return
    from skincal.collect.poses import duration_s, with_poses
    from skincal.collect.posture import Fingers, Mount
    from skincal.report.hand import plan_figure
    from skincal.report.style import PICTURE_MARK, save_whole
    from skincal.robot import Kinematics

    refuse_existing(picture, *inputs, force=force, mark=PICTURE_MARK)
    fingers = Fingers(Kinematics(hand), Mount.of(hand.meta))
    plan = with_poses(plan, fingers, CollectOptions())
    write_plan(plan, file, force=force)
    save_whole(plan_figure(plan, fingers.mount), picture, force=force)
    kinds = {kind: plan.count(kind) for kind in KINDS}
    seconds = duration_s(plan, fingers, CollectOptions())
    counts = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
    answer(
        as_json,
        {"presses": len(plan), "kinds": kinds, "poses": list(plan.pose_names), "seconds": seconds, "plan": file,
         "picture": picture},
        f"{plan.name}: {len(plan)} presses ({counts}), poses {', '.join(plan.pose_names)}",
        f"about {seconds:.0f} s of the hand's time; nothing was moved",
        f"plan: {file}   picture: {picture}",
    )  # fmt: skip
