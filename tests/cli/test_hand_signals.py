"""Signals while a hand moves, and files in the working folder that are named as modules: as a person runs a verb."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from commands import Fork, served

from skincal.hand.errors import HandError
from skincal.hand.remote import RemoteDriver

SLOW_HAND = """
import time
import numpy as np
from skincal.hand import HandDriver, HandState
from skincal.robot import hand_named

class SlowHand(HandDriver):
    name = "slow"
    period_s = 0.02
    description = hand_named()
    real_time = False
    def __init__(self, *, stop_s: float = 0.0):
        self.stop_s, self.ticks, self.connected = stop_s, 0, False
    def log(self, letter):
        with open("log", "a") as file:
            file.write(letter)
    def connect(self):
        self.connected = True
    def observe(self):
        assert self.connected
        time.sleep(self.period_s)
        self.ticks += 1
        self.log("o")
        q, t = self.description.home_rad, self.ticks * self.period_s
        return HandState(t, q.copy(), 0 * q, 0 * q, q.copy(), np.zeros(16), np.full(16, t))
    def act(self, command): pass
    def stop(self):
        time.sleep(self.stop_s)
        self.log("s")
    def close(self): pass
"""

SLOW_STAGE = """
import time
from skincal.hand.stage_sim import StageSim

class SlowStage(StageSim):
    def __init__(self, *, stop_s: float = 0.0, seed: int = 0):
        super().__init__(seed=seed)
        self.stop_s = stop_s
    def log(self, letter):
        with open("log", "a") as file:
            file.write(letter)
    def observe(self):
        time.sleep(0.02)
        self.log("o")
        return super().observe()
    def stop(self):
        time.sleep(self.stop_s)
        self.log("s")
"""


def signalled(folder: Path, number: int, times: int, stop_s: float, rig: str = "hand") -> tuple[int, str]:
    """Moves a rig, and sends signals once it has given states; returns exit status and standard error."""
    (folder / f"slow_{rig}.py").write_text({"hand": SLOW_HAND, "stage": SLOW_STAGE}[rig])
    command = ["hand", "test", "slow_hand:SlowHand", "--driver-option", f"stop_s={stop_s}"]
    if rig == "stage":
        command[:3] = ["collect", "--out", "run", "--driver", "slow_stage:SlowStage"]
    # A call that never returns must not keep the process either: it is one of its own.
    line, quiet = [sys.executable, "-m", "skincal", *command], subprocess.DEVNULL
    process = (
        subprocess.Popen(line, cwd=folder, stdout=quiet, stderr=subprocess.PIPE, text=True)
        if stop_s
        else Fork(folder, command)
    )
    log, deadline = folder / "log", time.monotonic() + 30
    while time.monotonic() < deadline and "oooo" not in (log.read_text() if log.exists() else ""):
        time.sleep(0.02)
    for _ in range(times):
        process.send_signal(number)
        time.sleep(0.05)
    _, said = process.communicate(timeout=20)
    assert process.returncode is not None
    return process.returncode, said


@pytest.mark.parametrize(
    ("rig", "number"),
    [("hand", n) for n in (signal.SIGTERM, signal.SIGTSTP, signal.SIGQUIT, signal.SIGUSR1)]
    + [("stage", n) for n in (signal.SIGTERM, signal.SIGTSTP, signal.SIGUSR1)],
)
def test_every_signal_stops_the_rig(tmp_path: Path, rig: str, number: int) -> None:
    status, err = signalled(tmp_path, number, 1, 0.0, rig)
    # A state that was under way may come after the stop.
    assert "s" in (tmp_path / "log").read_text()[-2:]
    *before, last = err.splitlines()
    assert last.startswith(f"skincal: interrupted. The {rig} was stopped.")
    assert rig == "stage" or (before, last) == ([], "skincal: interrupted. The hand was stopped.")
    assert status == 130


@contextmanager
def served_by_fork(folder: Path, *options: str) -> Iterator[tuple[Fork, str]]:
    """Serve a hand in a fork, of which standard output is not kept: at an address of our own choice."""
    address = f"ipc://{folder}/hand"
    process = Fork(folder, ["serve-hand", *options, "--bind", address])
    try:
        yield process, address
    finally:
        process.send_signal(signal.SIGKILL)


@pytest.mark.parametrize(
    ("number", "stop_s"), [(signal.SIGTSTP, 0.0), (signal.SIGUSR1, 0.0), (signal.SIGTERM, 30.0)]
)
def test_every_signal_stops_a_hand_that_is_served(tmp_path: Path, number: int, stop_s: float) -> None:
    (tmp_path / "slow_hand.py").write_text(SLOW_HAND)
    options = ["--driver", "slow_hand:SlowHand", "--driver-option", f"stop_s={stop_s}"]
    # A call that never returns must not keep the process either: it is one of its own.
    serving = served(*options, folder=tmp_path) if stop_s else served_by_fork(tmp_path, *options)
    with serving as (process, address):
        client = RemoteDriver(address, silence_s=20.0)
        client.connect()
        client.observe()
        process.send_signal(number)
        _, err = process.communicate(timeout=20)
    status = process.returncode
    with suppress(HandError):
        client.close()
    if stop_s:
        assert status == 1 and "Cut the hand's power" in err.splitlines()[-1]
    else:
        assert status == 0 and "s" in (tmp_path / "log").read_text()[-2:]


@pytest.mark.parametrize(("rig", "number"), [("hand", signal.SIGINT), ("stage", signal.SIGTERM)])
def test_repeated_signals_report_a_rig_not_stopped(tmp_path: Path, rig: str, number: int) -> None:
    status, err = signalled(tmp_path, number, 4, 30.0, rig)
    assert f"Cut the {rig}'s power." in err and "was stopped" not in err and "Traceback" not in err
    assert rig == "stage" or "stop() did not return within 0.5 s! Cut" in err
    assert status != 0


@pytest.mark.parametrize(
    ("command", "names"),
    [
        (("hand", "list"), ("typer", "pybullet", "numpy", "zmq")),
        (("hand", "test", "remote", "--driver-option", "address=nowhere"), ("zmq", "numpy")),
        (("hand", "test", "my_module:Missing"), ("numpy", "zmq", "pybullet")),
    ],
)
def test_files_in_the_working_folder_are_not_run(
    tmp_path: Path, command: tuple[str, ...], names: tuple[str, ...]
) -> None:
    for name in names:
        (tmp_path / f"{name}.py").write_text("open('ran', 'w')\n")
    (tmp_path / "my_module.py").write_text(
        "import os, sys\nassert sys.path[-1] == os.getcwd() not in sys.path[:-1]\nopen('mine', 'w')\n"
    )
    subprocess.run(
        [sys.executable, "-m", "skincal", *command],
        cwd=tmp_path,
        capture_output=True,
        check=False,
        timeout=60,
    )
    assert not (tmp_path / "ran").exists()
    assert (tmp_path / "mine").exists() == ("my_module:Missing" in command)
