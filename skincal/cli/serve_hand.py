"""``skincal serve-hand``: the server side of a remote hand."""

from __future__ import annotations

import signal
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

from skincal.cli import options
from skincal.cli.options import example, option
from skincal.cli.terminal import print_json, say

if TYPE_CHECKING:
    from skincal.hand.serve import HandServer

EPILOG = example(
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
