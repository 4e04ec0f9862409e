"""``skincal hand``: list drivers, show a hand, test a driver against the contract, make keys."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.common import ForceOption, JsonOption, example, print_json, say
from skincal.cli.interrupt import moving

if TYPE_CHECKING:
    from rich.table import Table

    from skincal.hand.contract import CheckResult, ContractReport
    from skincal.hand.registry import DriverOption
    from skincal.robot import HandDescription

app = typer.Typer(
    no_args_is_help=True,
    help="Drivers of hands: list them, test one, show a hand, make keys.",
    epilog=example("skincal hand list"),
)

RigOption = Annotated[
    str, typer.Option("--driver", help="Driver of the hand: a name of `skincal hand list`, or module:Class.")
]
DriverOptionsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--driver-option",
        metavar="KEY=VALUE",
        help="An option of the driver; may be repeated. `skincal hand list` shows them.",
    ),
]

BeyondLimitsOption = Annotated[
    bool,
    typer.Option("--beyond-limits", help="Accept limits in hand.toml that are beyond those of any finger."),
]


@app.command("list", epilog=example("skincal hand list", "skincal hand list --json"))
def list_drivers(as_json: JsonOption = False) -> None:
    """List the installed drivers with their options."""
    from skincal.errors import SkincalError
    from skincal.hand.convert import is_text
    from skincal.hand.registry import driver_class, driver_names, driver_options

    drivers: list[dict[str, Any]] = []
    for name in driver_names():
        try:
            made = driver_class(name)
            options = [_option(option) for option in driver_options(name) if is_text(option.kind)]
            place = f"{made.__module__}:{getattr(made, '__qualname__', made)}"
            drivers.append({"name": name, "class": place, "options": options, "error": None})
        except SkincalError as error:
            drivers.append({"name": name, "class": None, "options": [], "error": str(error)})
    if as_json:
        print_json({"drivers": drivers})
        return
    for driver in drivers:
        for line in _driver_lines(driver):
            typer.echo(line)


@app.command(
    short_help="Show a hand: joints, limits, fingers, indenter.",
    epilog=example("skincal hand show", "skincal hand show my_hand/hand.toml --json"),
)
def show(
    hand: Annotated[
        str, typer.Argument(metavar="[HAND]", help="Name of a hand, or its hand.toml.")
    ] = "dlr_hand_2",
    beyond_limits: BeyondLimitsOption = False,
    as_json: JsonOption = False,
) -> None:
    """Show a hand's description: joints, limits, fingers, sensor."""
    from skincal.hand.hands import hand_named
    from skincal.robot import check_limits

    description = hand_named(hand)
    check_limits(description, beyond=beyond_limits)
    if as_json:
        print_json(_hand_json(description))
        return
    from rich.console import Console

    console = Console()
    console.print(_joints_table(description))
    for name, text in _hand_lines(description):
        typer.echo(f"{name:10s}{text}")


@app.command(
    short_help="Check a driver against the contract.",
    epilog=example(
        "skincal hand test sim --driver-option seed=3",
        "skincal hand test my_package.my_hand:MyHand --driver-option port=/dev/ttyUSB0 --no-move",
    ),
)
def test(
    driver: Annotated[str, typer.Argument(metavar="DRIVER", help="A driver's name, or module:Class.")],
    driver_option: DriverOptionsOption = None,
    step_deg: Annotated[
        float, typer.Option("--step-deg", min=0.1, max=5.0, help="Largest motion of a joint [°].")
    ] = 1.0,
    move: Annotated[bool, typer.Option("--move/--no-move", help="Move the hand, or only observe it.")] = True,
    beyond_limits: BeyondLimitsOption = False,
    as_json: JsonOption = False,
) -> None:
    """Check a driver against the contract that skincal expects of a hand.

    Connects the hand about fifteen times; with --move, moves each joint by --step-deg and back at the end. Keep the
    hand's way clear. Exit status 0: every check passed; 1: one did not.
    """
    import math

    from skincal.hand.contract import ContractOptions, run_contract
    from skincal.hand.guard_options import GuardOptions
    from skincal.hand.registry import create_driver, create_rig, parse_options
    from skincal.hand.stage import StageDriver
    from skincal.hand.stage_checks import run_stage_checks
    from skincal.robot import check_limits

    find_modules_here(driver)
    options = parse_options(driver_option or [])
    # A wrong name or option is not a failed check.
    first = create_rig(driver, **options)
    # A terminal and JSON show the checks as they come; otherwise the table shows all at the end.
    report_check = _report_check if as_json or sys.stderr.isatty() else _ignore_check
    if isinstance(first, StageDriver):

        def another() -> StageDriver:
            made = create_rig(driver, **options)
            assert isinstance(made, StageDriver)
            return made

        with moving():
            guard = GuardOptions(beyond_limits=beyond_limits)
            report = run_stage_checks(driver, another, move=move, guard=guard, told=report_check)
    else:
        check_limits(first.description, beyond=beyond_limits)
        tried = ContractOptions(step_rad=math.radians(step_deg), move=move, beyond_limits=beyond_limits)
        with moving():
            report = run_contract(driver, lambda: create_driver(driver, **options), tried, report_check)
    if as_json:
        print_json(_report_json(report))
    else:
        from rich.console import Console

        Console().print(_report_table(report))
        typer.echo(f"{driver}: {report.count('passed')} passed, {report.count('failed')} failed")
    if not report.ok:
        raise typer.Exit(1)


@app.command(
    short_help="Make the key pairs of a remote hand.", epilog=example("skincal hand keys --out keys")
)
def keys(
    out: Annotated[Path, typer.Option("--out", help="Folder for the keys.")],
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Make the key pairs of a remote hand: hand/ for its computer, client/ for the one that moves it."""
    from skincal.hand.sockets import make_keys

    make_keys(out, force=force)
    if as_json:
        print_json({"hand": out / "hand", "client": out / "client"})
        return
    typer.echo(f"{out}/hand    stays on the hand's computer: skincal serve-hand --keys {out}/hand")
    typer.echo(
        f"{out}/client  goes to the client's computer: --driver remote --driver-option keys={out}/client"
    )
    say("Whoever has client/ can move the hand: copy it over a private channel.")


def find_modules_here(driver: str) -> None:
    """Let ``module:Class`` name a module of the working folder, which comes last so that it hides nothing installed."""
    here = str(Path.cwd())
    if ":" in driver and here not in sys.path:
        sys.path.append(here)


def _report_check(result: CheckResult) -> None:
    say(f"{result.status:8s}{result.name}")


def _ignore_check(result: CheckResult) -> None:
    return


def _option(option: DriverOption) -> dict[str, Any]:
    from skincal.hand.convert import type_text

    default = None if option.required else option.default
    plain = isinstance(default, str | int | float | bool | None)
    return {
        "name": option.name,
        "type": type_text(option.kind),
        "required": option.required,
        "default": default if plain else str(default),
        "text": option.text,
    }


def _driver_lines(driver: dict[str, Any]) -> list[str]:
    """Return a driver and its options as lines of text."""
    if driver["error"]:
        return [driver["name"], f"  {driver['error']}"]
    lines = [driver["name"]]
    for option in driver["options"]:
        default = "required" if option["required"] else f"default {option['default']}"
        lines.append(
            f"  {option['name']:14s}{option['type']} ({default}){': ' * bool(option['text'])}{option['text']}"
        )
    return lines


def _report_table(report: ContractReport) -> Table:
    from rich.markup import escape
    from rich.table import Table

    colours = {"passed": "green", "failed": "red", "skipped": "yellow"}
    table = Table(box=None, padding=(0, 2, 0, 0))
    for name in ("check", "", "result"):
        table.add_column(name)
    for result in report.results:
        colour, got = colours[result.status], result.got
        if result.status == "failed":
            got = f"expected: {result.expected}; got: {result.got}"
        table.add_row(result.name, f"[{colour}]{result.status}[/{colour}]", escape(got))
    return table


def _report_json(report: ContractReport) -> dict[str, Any]:
    checks = [
        {"name": r.name, "status": r.status, "expected": r.expected, "got": r.got} for r in report.results
    ]
    counts = {status: report.count(status) for status in ("passed", "failed", "skipped")}
    return {"driver": report.driver, "ok": report.ok, **counts, "checks": checks}


def _joints_table(description: HandDescription) -> Table:
    import math

    from rich.table import Table
    from rich.text import Text

    limits, gains = description.limits, description.gains
    table = Table(title=Text(description.name), title_justify="left", box=None, padding=(0, 2, 0, 0))
    for name in ("joint", "from deg", "to deg", "home deg", "deg/s", "N m", "N m/rad", "N m s/rad"):
        table.add_column(name, justify="left" if name == "joint" else "right")
    for j, name in enumerate(description.joints):
        degrees = (limits.lower_rad, limits.upper_rad, description.home_rad, limits.velocity_rad_per_s)
        cells = [f"{math.degrees(values[j]):.4g}" for values in degrees]
        others = (limits.torque_nm, gains.stiffness_nm_per_rad, gains.damping_nms_per_rad)
        table.add_row(name, *cells, *(f"{values[j]:.4g}" for values in others))
    return table


def _hand_lines(description: HandDescription) -> list[tuple[str, str]]:
    meta, skin, indenter = description.meta, description.skin_finger, description.indenter_finger
    shape = "" if meta.surface.radius_m is None else f" of radius {meta.surface.radius_m * 1e3:g} mm"
    ball = (
        ""
        if meta.indenter.radius_m is None
        else f", {meta.indenter.kind} of {meta.indenter.radius_m * 1e3:g} mm"
    )
    return [
        ("skin", f"{skin.name} ({', '.join(skin.joints)}), link {skin.tip_link}"),
        ("indenter", f"{indenter.name} ({', '.join(indenter.joints)}), link {indenter.tip_link}{ball}"),
        ("sensor", f"{meta.sensor.rows} x {meta.sensor.cols} taxels on a {meta.surface.kind}{shape}"),
        ("force", f"never above {description.max_force_n:g} N"),
        ("URDF", str(description.urdf)),
        ("SHA-256", description.digest),
    ]


def _hand_json(description: HandDescription) -> dict[str, Any]:
    limits, sensor = description.limits, description.meta.sensor
    return {
        "name": description.name,
        "urdf": description.urdf,
        "sha256": description.digest,
        "joints": description.joints,
        "lower_rad": limits.lower_rad,
        "upper_rad": limits.upper_rad,
        "velocity_rad_per_s": limits.velocity_rad_per_s,
        "torque_nm": limits.torque_nm,
        "home_rad": description.home_rad,
        "max_force_n": description.max_force_n,
        "skin_finger": description.skin_finger.name,
        "indenter_finger": description.indenter_finger.name,
        "sensor": {"rows": sensor.rows, "cols": sensor.cols},
    }
