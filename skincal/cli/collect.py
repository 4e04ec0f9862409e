"""``skincal collect``: press a hand's own skin and write the presses as a dataset."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.collect_plan import plan_of, show_plan
from skincal.cli.common import ForceOption, JsonOption, OutOption, SeedOption, example, print_json, say, warn
from skincal.cli.hand import BeyondLimitsOption, DriverOptionsOption, RigOption, find_modules_here
from skincal.cli.interrupt import moving

if TYPE_CHECKING:
    from skincal.collect import Collected, Need, Plan
    from skincal.hand import HandDriver, StageDriver
    from skincal.robot import HandDescription

EPILOG = example(
    "skincal collect --driver sim --seed 7 --out run",
    "skincal collect --driver sim --effect hysteresis=1 --truth truth.json --out run --json",
)

MEMORY = "skin.memory"
"""File in the folder of an unfinished session: the contact history that the simulated skin remembers."""


def collect(
    out: OutOption,
    driver: RigOption = "sim",
    seed: SeedOption = 0,
    protocol: Annotated[
        str | None,
        typer.Option(
            "--protocol",
            help="`full`: presses that can show every effect except tangential force and, without "
            "--second-indenter-mm, the indenter's size; `paper`: 60 static ones.",
            show_default="full",
        ),
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option("--plan", help="A plan of your own, TOML or CSV, instead of a protocol."),
    ] = None,
    plan_only: Annotated[
        bool,
        typer.Option(
            "--plan-only", help="Move nothing; write the plan and its picture, as OUT-plan.toml and .png."
        ),
    ] = False,
    second_indenter_mm: Annotated[
        float | None,
        typer.Option(
            "--second-indenter-mm",
            min=0.5,
            max=50.0,
            help="Radius of a second sphere: the full protocol ends with presses with it; you are asked to "
            "change the cap.",
        ),
    ] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            "--effect",
            metavar="NAME=STRENGTH",
            help="Effect of the simulated skin; strength 1 is a typical case. May be repeated.",
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option("--truth", help="File for the simulated hand's hidden truth (JSON)."),
    ] = None,
    hand: Annotated[
        str | None,
        typer.Option("--hand", help="Name of the hand, or its hand.toml, for drivers that take one."),
    ] = None,
    driver_option: DriverOptionsOption = None,
    beyond_limits: BeyondLimitsOption = False,
    restart: Annotated[
        bool, typer.Option("--restart", help="Discard an interrupted session and start over.")
    ] = False,
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Press the skin with the hand's own indenter, at a regulated force, and write the dataset.

    Contact points and forces come from joint angles and torques. Every finished press is saved at once: an interrupted
    session continues when the same command is given again.
    """
    from skincal.collect import journal_folder
    from skincal.files import refuse_existing
    from skincal.hand.registry import create_rig
    from skincal.hand.stage import StageDriver
    from skincal.robot import check_limits

    find_modules_here(driver)
    options = options_of(driver, seed, effect, truth, hand, driver_option)
    rig = create_rig(driver, **options)
    if isinstance(rig, StageDriver):
        _stage(rig, driver, options, seed, plan, protocol, plan_only, second_indenter_mm, out, truth,
               force=force, restart=restart, beyond_limits=beyond_limits, as_json=as_json)  # fmt: skip
        return
    description = rig.description
    check_limits(description, beyond=beyond_limits)
    chosen = plan_of(plan, protocol, seed, description, second_indenter_mm)
    inputs = [Path(one) for one in (plan, hand) if one is not None]
    if plan_only:
        show_plan(chosen, description, out, inputs, force, as_json)
        return
    if truth is not None and not journal_folder(out).exists():
        from skincal.hand.sim import TRUTH_FORMAT

        refuse_existing(truth, *inputs, force=force, mark=TRUTH_FORMAT)
    source = _source(driver, seed, chosen, effect, description)
    found = press_plan(chosen, description, driver, options, out, seed=seed, source=source, force=force,
                       inputs=inputs, restart=restart, beyond_limits=beyond_limits)  # fmt: skip
    _conclude(found, out, as_json)


def _conclude(found: Collected, out: Path, as_json: bool) -> None:
    """Report a finished session; status 1 if its dataset cannot be fitted."""
    if as_json:
        print_json(_as_json(found, out))
    else:
        _tell(found, out)
    warn(found.rest_shifts)
    if found.problems:
        warn(found.problems)
        say(
            f"skincal: error: {out}: expected a dataset that can be fitted; got the problems above. Nothing is lost."
        )
        raise typer.Exit(1)


def press_plan(
    plan: Plan,
    description: HandDescription,
    driver: str,
    options: dict[str, Any],
    out: Path,
    *,
    seed: int,
    source: str,
    force: bool = False,
    inputs: Sequence[Path] = (),
    restart: bool = False,
    beyond_limits: bool = False,
    start_s: float = 0.0,
) -> Collected:
    """Make the presses of a plan on a hand, or go on with them, with progress on the terminal.

    Args:
        plan: the presses.
        description: the hand.
        driver: name of its driver.
        options: of the driver.
        out: folder of the dataset.
        seed: as given, to recognize an interrupted session.
        source: for ``dataset.toml``.
        force: whether to replace an existing dataset.
        inputs: files that must not be replaced.
        restart: whether to discard an interrupted session.
        beyond_limits: whether the guard's limits may be exceeded.
        start_s: clock of a simulated hand at the beginning [s].
    """
    from skincal.collect import collect as run
    from skincal.hand import GuardOptions

    key = {"driver": driver, "seed": seed, "driver options": {k: str(v) for k, v in sorted(options.items())}}
    with _progress(len(plan), description) as reporter, moving(lambda: _kept(out)), _resumable(out):
        return run(
            plan,
            description,
            _maker(driver, options, out, reporter.pause, start_s),
            out,
            key=key,
            guard=GuardOptions(beyond_limits=beyond_limits),
            source=source,
            force=force,
            inputs=inputs,
            restart=restart,
            watch=reporter,
        )


def _stage(
    rig: StageDriver,
    driver: str,
    options: dict[str, Any],
    seed: int,
    plan: Path | None,
    protocol: str | None,
    plan_only: bool,
    second_indenter_mm: float | None,
    out: Path,
    truth: Path | None,
    *,
    force: bool,
    restart: bool,
    beyond_limits: bool,
    as_json: bool,
) -> None:
    """Collect the session of a stage."""
    from skincal.collect import journal_folder, write_plan
    from skincal.collect.plan_file import FORMAT
    from skincal.collect.stage import collect_stage, stage_plan
    from skincal.errors import InputError, Problem
    from skincal.files import refuse_existing
    from skincal.hand import GuardOptions
    from skincal.hand.stage_guard import check_stage
    from skincal.hand.stage_sim import TRUTH_FORMAT
    from skincal.progress import stage_bars

    if second_indenter_mm is not None:
        expected, got = "a hand's cap; a stage presses with its own indenter", f"{second_indenter_mm:g}"
        raise InputError([Problem("--second-indenter-mm", expected, got)])
    check_stage(rig.description, beyond=beyond_limits)
    chosen = stage_plan(plan_of(plan, protocol, seed, rig.description, None), rig.description)
    inputs = [] if plan is None else [plan]
    if plan_only:
        file = out.with_name(f"{out.name}-plan.toml")
        refuse_existing(file, *inputs, force=force, mark=FORMAT)
        write_plan(chosen, file, force=force)
        print_json({"presses": len(chosen), "plan": file}) if as_json else typer.echo(f"plan: {file}")
        return
    if truth is not None and not journal_folder(out).exists():
        refuse_existing(truth, *inputs, force=force, mark=TRUTH_FORMAT)
    key = {"driver": driver, "seed": seed, "driver options": {k: str(v) for k, v in sorted(options.items())}}
    source = f"skincal collect: stage, driver {driver}, plan {chosen.name}, {rig.description.name}"
    with stage_bars() as reporter, moving(lambda: _kept(out)), _resumable(out):
        found = collect_stage(
            chosen,
            lambda: rig,
            out,
            key=key,
            guard=GuardOptions(beyond_limits=beyond_limits),
            source=source,
            force=force,
            inputs=inputs,
            restart=restart,
            watch=lambda done, total: reporter("presses", done, total),
        )
    _conclude(found, out, as_json)


def options_of(
    driver: str,
    seed: int,
    effect: list[str] | None,
    truth: Path | None,
    hand: str | None,
    given: list[str] | None,
) -> dict[str, Any]:
    """Return the driver's options. An option of this command that the driver lacks is an error when it is created."""
    from skincal.errors import InputError, Problem
    from skincal.hand.registry import driver_options, parse_options

    known = {option.name for option in driver_options(driver)}
    options: dict[str, Any] = dict(parse_options(given or []))
    ours = {"effects": _effects(effect), "truth_path": truth, "hand": hand}
    own: dict[str, Any] = {name: value for name, value in ours.items() if value}
    if "seed" in known:
        own["seed"] = seed
    twice = [name for name in own if name in options]
    if twice:
        got = ", ".join(twice)
        raise InputError([Problem("--driver-option", "options without an own command-line option", got)])
    return {**options, **own}


def _effects(given: list[str] | None) -> dict[str, float]:
    from skincal.errors import InputError, Problem

    effects: dict[str, float] = {}
    for text in given or []:
        name, _, strength = text.partition("=")
        if name.strip() in effects:
            raise InputError([Problem("--effect", "each effect once", f"{name.strip()} twice")])
        try:
            effects[name.strip()] = float(strength)
        except ValueError:
            raise InputError(
                [Problem("--effect", "NAME=STRENGTH, the strength a number", f'"{text}"')]
            ) from None
    return effects


def _create(driver: str, options: dict[str, Any], later: dict[str, Any]) -> HandDriver:
    from skincal.hand.registry import create_driver

    return create_driver(driver, **{**options, **later})


def _maker(
    driver: str, options: dict[str, Any], out: Path, pause: Callable[[], None], start_s: float
) -> Callable[[Need], HandDriver]:
    """Return a factory of drivers for the point that the session has reached; it asks for another cap where needed."""
    from skincal.hand.registry import driver_options

    known = {option.name for option in driver_options(driver)}
    mounted: list[float | None] = [None]

    def make(need: Need) -> HandDriver:
        if need.indenter_radius_m != mounted[0] and "indenter_radius_m" not in known:
            pause()
            size = (
                "the hand's own" if need.indenter_radius_m is None else f"{1e3 * need.indenter_radius_m:g} mm"
            )
            typer.confirm(f"Mount the cap with the sphere of radius: {size}. Done?", abort=True, err=True)
            mounted[0] = need.indenter_radius_m
        return _create(driver, options, _later(known - set(options), need, out, start_s))

    return make


def _later(known: set[str], need: Need, out: Path, start_s: float) -> dict[str, Any]:
    """Return the options that tell a simulated hand about its session: the clock, the cap and the contact history."""
    from skincal.collect import journal_folder
    from skincal.collect.connection import GAP_S

    values: dict[str, Any] = {
        "start_s": (need.session_s or start_s) + GAP_S if need.session_s or start_s > 0 else None,
        "indenter_radius_m": need.indenter_radius_m,
        "memory_path": journal_folder(out) / MEMORY,
    }
    return {name: value for name, value in values.items() if name in known and value is not None}


def _source(
    driver: str, seed: int, plan: Plan, effect: list[str] | None, description: HandDescription
) -> str:
    simulated = f", seed {seed}" if driver == "sim" else ""
    effects = f", effects {', '.join(effect)}" if effect else ""
    return f"skincal collect: driver {driver}{simulated}{effects}, plan {plan.name}, {description.name}"


@contextmanager
def _progress(total: int, hand: HandDescription) -> Generator[Any]:
    from skincal.cli.collect_progress import Told

    reporter = Told(total, hand.meta.sensor)
    try:
        with reporter:
            yield reporter
    finally:
        reporter.pause()


@contextmanager
def _resumable(out: Path) -> Generator[None]:
    """Say, when a session ends early, what is saved and how to continue."""
    from skincal.errors import WorkError

    try:
        yield
    except WorkError:
        say(f"skincal: the session ended early. {_kept(out)}")
        raise


def _kept(out: Path) -> str:
    from skincal.collect import journal_folder

    folder = journal_folder(out)
    done = len(list(folder.glob("press-*.npz")))
    if not done:
        return "No press was finished."
    return f"{done} finished presses are saved in {folder}; give the same command again to continue."


def _as_json(found: Collected, out: Path) -> dict[str, Any]:
    return {
        "presses": len(found.dataset.presses),
        "missed_target": found.missed_target,
        "dataset": out,
        "status": found.statuses,
        "resumed": found.resumed,
        "session_s": round(found.session_s, 3),
        "rest_shifts": [str(shift) for shift in found.rest_shifts],
        "problems": [str(problem) for problem in found.problems],
    }


def _tell(found: Collected, out: Path) -> None:
    if found.resumed:
        say(f"{found.resumed} presses come from the interrupted session.")
    marks = ", ".join(f"{count} {name}" for name, count in found.statuses.items())
    typer.echo(
        f"{len(found.dataset.presses)} presses ({marks}), {found.missed_target} missed their target, "
        f"{found.session_s:.0f} s of the hand's time"
    )
    typer.echo(f"dataset: {out}")
