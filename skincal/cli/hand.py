"""``skincal hand``: list drivers, show and test one, make keys; ``skincal serve-hand``: serve a remote hand."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from skincal.cli import options
from skincal.cli.interrupt import moving
from skincal.cli.options import argument, example, find_modules_here, option
from skincal.cli.terminal import answer, picked, print_json, say, table
from skincal.progress import console

if TYPE_CHECKING:
    from rich.table import Table

    from skincal.hand.contract import ContractReport
    from skincal.hand.driver import StageDriver
    from skincal.hand.registry import DriverOption
    from skincal.hand.serve import HandServer
    from skincal.robot import HandDescription

_DRIVER = "A driver's name, or module:Class."

app = typer.Typer(
    no_args_is_help=True,
    help="Drivers of hands: list them, test one, show a hand, make keys.",
    epilog=example("skincal hand list"),
)


@app.command("list", epilog=example("skincal hand list", "skincal hand list --json"))
def list_drivers(as_json: options.Json = False) -> None:
    """List the installed drivers with their options."""
    from skincal.errors import SkincalError
    from skincal.hand.registry import driver_class, driver_names, driver_options, is_text

    drivers: list[dict[str, Any]] = []
    lines: list[str] = []
    for name in driver_names():
        driver: dict[str, Any] = {"name": name, "class": None, "options": [], "error": None}
        drivers.append(driver)
        lines.append(name)
        try:
            made = driver_class(name)
            driver["options"] = [_option(one) for one in driver_options(name) if is_text(one.kind)]
            driver["class"] = f"{made.__module__}:{getattr(made, '__qualname__', made)}"
        except SkincalError as error:
            driver |= {"options": [], "error": str(error)}
            lines.append(f"  {error}")
        for one in driver["options"]:
            default = "required" if one["required"] else f"default {one['default']}"
            text = f": {one['text']}" if one["text"] else ""
            lines.append(f"  {one['name']:13s} {one['type']} ({default}){text}")
    answer(as_json, {"drivers": drivers}, *lines)


def _option(one: DriverOption) -> dict[str, Any]:
    from skincal.hand.registry import type_text

    default = None if one.required else one.default
    return {
        "name": one.name,
        "type": type_text(one.kind),
        "required": one.required,
        "default": default if isinstance(default, str | int | float | bool | None) else str(default),
        "text": one.text,
    }


@app.command(
    short_help="Show a hand: joints, limits, fingers, indenter.",
    epilog=example("skincal hand show", "skincal hand show my_hand/hand.toml --json"),
)
def show(
    hand: Annotated[str, argument("[HAND]", "Name of a hand, or its hand.toml.")] = "dlr_hand_2",
    beyond_limits: options.BeyondLimits = False,
    as_json: options.Json = False,
) -> None:
    """Show a hand's description: joints, limits, fingers, sensor."""
    from skincal.robot import check_limits, hand_named

    description = hand_named(hand)
    check_limits(description, beyond=beyond_limits)
    limits = description.limits
    content = {
        "name": description.name,
        "urdf": description.urdf,
        "sha256": description.digest,
        "joints": description.joints,
        **picked(limits, "lower_rad upper_rad velocity_rad_per_s torque_nm"),
        **picked(description, "home_rad max_force_n"),
        "skin_finger": description.skin_finger.name,
        "indenter_finger": description.indenter_finger.name,
        "sensor": picked(description.meta.sensor, "rows cols"),
    }
    answer(as_json, content, _joints(description), *_fingers(description))


def _joints(description: HandDescription) -> Table:
    from rich.text import Text

    limits, gains = description.limits, description.gains
    columns = {
        "from deg": limits.lower_rad,
        "to deg": limits.upper_rad,
        "home deg": description.home_rad,
        "deg/s": limits.velocity_rad_per_s,
        "N m": limits.torque_nm,
        "N m/rad": gains.stiffness_nm_per_rad,
        "N m s/rad": gains.damping_nms_per_rad,
    }
    rows = [
        (name, *(f"{math.degrees(v[j]) if 'deg' in unit else v[j]:.4g}" for unit, v in columns.items()))
        for j, name in enumerate(description.joints)
    ]
    title = Text(description.name)
    return table(("joint", *columns), rows, right=True, title=title, title_justify="left")


def _fingers(description: HandDescription) -> list[str]:
    meta, skin, indenter = description.meta, description.skin_finger, description.indenter_finger
    lines = {
        "skin": f"{skin.name} ({', '.join(skin.joints)}), link {skin.tip_link}",
        "indenter": f"{indenter.name} ({', '.join(indenter.joints)}), link {indenter.tip_link}, {meta.indenter}",
        "sensor": f"{meta.sensor.rows} x {meta.sensor.cols} taxels on a {meta.surface}",
        "force": f"never above {description.max_force_n:g} N",
        "URDF": str(description.urdf),
        "SHA-256": description.digest,
    }
    return [f"{name:10s}{text}" for name, text in lines.items()]


@app.command(
    short_help="Check a driver against the contract.",
    epilog=example(
        "skincal hand test sim --driver-option seed=3",
        "skincal hand test my_package.my_hand:MyHand --driver-option port=/dev/ttyUSB0 --no-move",
    ),
)
def test(
    driver: Annotated[str, argument("DRIVER", _DRIVER, callback=find_modules_here)],
    driver_option: options.DriverOptions = None,
    step_deg: Annotated[float, option("Largest motion of a joint [°].", min=0.1, max=5.0)] = 1.0,
    move: Annotated[bool, option("Move the hand, or only observe it.")] = True,
    beyond_limits: options.BeyondLimits = False,
    as_json: options.Json = False,
) -> None:
    """Check a driver against the contract that skincal expects of a hand.

    Connects the hand about fifteen times; with --move, moves each joint by --step-deg and back at the end. Keep the
    hand's way clear. Exit status 0: every check passed; 1: one did not.
    """
    from skincal.hand.contract import CheckResult, ContractOptions
    from skincal.hand.contract_checks import run_contract
    from skincal.hand.driver import StageDriver
    from skincal.hand.guard_options import GuardOptions
    from skincal.hand.registry import create_driver, create_rig, parse_options
    from skincal.hand.stage_checks import run_stage_checks
    from skincal.robot import check_limits

    def show_check(result: CheckResult) -> None:
        # A terminal and JSON show the checks as they come; otherwise the table shows all at the end.
        if as_json or console().is_terminal:
            say(f"{result.status:8s}{result.name}")

    settings = parse_options(driver_option or [])
    first = create_rig(driver, **settings)  # A wrong name or option is not a failed check.
    if not isinstance(first, StageDriver):
        check_limits(first.description, beyond=beyond_limits)
    with moving():
        if isinstance(first, StageDriver):
            guard = GuardOptions(beyond_limits=beyond_limits)
            another = cast("Callable[[], StageDriver]", lambda: create_rig(driver, **settings))
            report = run_stage_checks(driver, another, move=move, guard=guard, progress=show_check)
        else:
            limits = ContractOptions(step_rad=math.radians(step_deg), move=move, beyond_limits=beyond_limits)
            report = run_contract(driver, lambda: create_driver(driver, **settings), limits, show_check)
    checks = [picked(result, "name status expected got") for result in report.results]
    counts = {status: report.count(status) for status in ("passed", "failed", "skipped")}
    content = {"driver": report.driver, "ok": report.ok, **counts, "checks": checks}
    summary = f"{driver}: {counts['passed']} passed, {counts['failed']} failed"
    answer(as_json, content, _checks(report), summary)
    if not report.ok:
        raise typer.Exit(1)


def _checks(report: ContractReport) -> Table:
    from rich.markup import escape

    colours = {"passed": "green", "failed": "red", "skipped": "yellow"}
    rows: list[tuple[str, str, str]] = []
    for result in report.results:
        failed = f"expected: {result.expected}; got: {result.got}"
        got = failed if result.status == "failed" else result.got
        rows.append((result.name, f"[{colours[result.status]}]{result.status}[/]", escape(got)))
    return table(("check", "", "result"), rows)


@app.command(
    short_help="Make the key pairs of a remote hand.", epilog=example("skincal hand keys --out keys")
)
def keys(
    out: Annotated[Path, option("Folder for the keys.")],
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Make the key pairs of a remote hand: hand/ for its computer, client/ for the one that moves it."""
    from skincal.hand.sockets import make_keys

    make_keys(out, force=force)
    answer(
        as_json,
        {"hand": out / "hand", "client": out / "client"},
        f"{out}/hand    stays on the hand's computer: skincal serve-hand --keys {out}/hand",
        f"{out}/client  goes to the client's computer: --driver remote --driver-option keys={out}/client",
        then="Whoever has client/ can move the hand: copy it over a private channel.",
    )


SERVE_EPILOG = example(
    "skincal serve-hand --driver sim --bind tcp://127.0.0.1:5555",
    "skincal serve-hand --driver my-hand --bind tcp://192.168.1.4:5555 --keys keys/hand",
)
_BIND = "Address to listen at; port * takes any free port."
_KEYS = "Folder hand/ of `skincal hand keys`; any address but loopback needs it."
_WATCHDOG = "Time after which a silent client loses the hand."


def serve_hand(
    driver: options.Driver,
    driver_option: options.DriverOptions = None,
    bind: Annotated[str, option(_BIND)] = "tcp://127.0.0.1:5555",
    keys: Annotated[Path | None, option(_KEYS)] = None,
    watchdog_s: Annotated[float, option(_WATCHDOG, min=0.05, max=60.0)] = 2.0,
    timeout_s: Annotated[float, option("Longest time of a call to the driver.", min=0.05, max=60.0)] = 1.0,
    force_check: Annotated[bool, option("Limit the contact force on this side, too.")] = True,
    sessions: Annotated[int | None, option("End after this many clients.", min=1, max=2**31)] = None,
    beyond_limits: options.BeyondLimits = False,
    as_json: options.Json = False,
) -> None:
    """Serve a hand to another computer, or to another program on this one.

    Serves one client at a time. Limits are enforced on this side, too, and the hand stops when its client falls silent.
    Ctrl-C stops the hand and ends. With --json the object is printed as soon as the hand can be reached.
    """
    from skincal.hand.guard_options import GuardOptions
    from skincal.hand.registry import create_driver, parse_options
    from skincal.hand.serve import HandServer, ServeOptions
    from skincal.hand.sockets import hand_keys
    from skincal.robot import joint_contact_force

    settings = parse_options(driver_option or [])
    guard = GuardOptions(timeout_s=timeout_s, beyond_limits=beyond_limits)
    server = HandServer(
        lambda: create_driver(driver, **settings),
        bind,
        keys=None if keys is None else hand_keys(keys),
        options=ServeOptions(watchdog_s=watchdog_s, guard=guard),
        contact_force=joint_contact_force if force_check else None,
    )
    with server:
        _end_on_signals(server)
        if as_json:
            print_json({"driver": driver, "address": server.address, "keys": keys is not None})
        say(f"{driver} listens at {server.address}; Ctrl-C stops the hand and ends")
        server.run(sessions=sessions)
    say(f"{driver}: ended after {server.sessions} clients")


def _end_on_signals(server: HandServer) -> None:
    """Let every signal that would end or suspend the process, unless ignored, end the loop, which stops the hand."""
    from skincal.signals import ENDING

    def end(number: int, frame: FrameType | None) -> None:
        server.end()

    for number in ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, end)
