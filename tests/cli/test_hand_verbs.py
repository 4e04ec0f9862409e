"""``skincal hand`` and ``skincal serve-hand``, as a person runs them."""

from __future__ import annotations

import json
import shutil
import signal
import sys
from pathlib import Path
from typing import Any

import pytest
from commands import Run, RunJson, served

import skincal.robot
from skincal.hand import create_driver
from skincal.hand.guard import GuardedHand

BAD_HAND = """
from skincal.hand import HandDriver
from skincal.robot import hand_named

class BadHand(HandDriver):
    name = "bad"
    period_s = 0.01
    description = hand_named()
    def connect(self): pass
    def observe(self): return None
    def act(self, command): pass
    def stop(self): pass
    def close(self): pass
"""


def test_list_names_the_shipped_drivers_and_their_options(run: Run, run_json: RunJson) -> None:
    drivers = {d["name"]: d for d in run_json("hand", "list")["drivers"]}
    assert {"sim", "replay", "remote"} <= set(drivers)
    assert drivers["sim"]["class"] == "skincal.hand.sim:SimDriver"
    options = {o["name"]: o for o in drivers["sim"]["options"]}
    assert options["seed"]["type"] == "whole number"
    assert {o["name"]: o["required"] for o in drivers["replay"]["options"]} == {
        "dataset": True,
        "hand": False,
    }
    status, out, _ = run("hand", "list")
    assert status == 0
    assert "  address       text (default tcp://127.0.0.1:5555): address of the server" in out


def test_show_tells_joints_limits_and_sensor(run: Run, run_json: RunJson) -> None:
    shown = run_json("hand", "show")
    assert len(shown["joints"]) == len(shown["lower_rad"]) == len(shown["home_rad"]) == 6
    status, out, _ = run("hand", "show")
    assert status == 0
    assert "forefinger_3" in out
    assert "never above 10 N" in out
    status, out, err = run("hand", "show", "no_such_hand")
    assert (status, out) == (2, "")
    assert 'expected one of dlr_hand_2; got "no_such_hand"' in err


def test_the_simulated_hand_keeps_the_contract(run: Run) -> None:
    status, out, err = run("hand", "test", "sim", "--driver-option", "seed=4", "--json")
    report: dict[str, Any] = json.loads(out)
    assert status == 0, out
    assert report["ok"] is True
    assert report["failed"] == report["skipped"] == 0
    assert "passed  commands are followed" in err


def test_a_bad_driver_is_named_with_what_was_expected(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bad_hand.py").write_text(BAD_HAND)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    status, out, _ = run("hand", "test", "bad_hand:BadHand", "--no-move", "--json")
    assert status == 1
    checks = {check["name"]: check for check in json.loads(out)["checks"]}
    assert checks["states are sound"]["status"] == "failed"
    assert "expected a HandState; got NoneType" in checks["states are sound"]["got"]
    assert checks["commands are followed"]["status"] == "skipped"
    status, out, _ = run("hand", "test", "bad_hand:BadHand", "--no-move")
    assert status == 1
    assert "failed" in out


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("hand", "test", "simm"), 'remote, replay, sim, stage-sim; got "simm"'),
        (("hand", "test", "sim", "--driver-option", "sead=3"), 'got "sead"'),
        (("hand", "test", "sim", "--driver-option", "seed"), 'expected KEY=VALUE; got "seed"'),
        (("serve-hand", "--driver", "sim", "--bind", "tcp://0.0.0.0:5555"), "without keys"),
        (("serve-hand", "--driver", "sim", "--keys", "nowhere"), "expected a key file"),
    ],
)
def test_a_wrong_command_line_is_status_two(run: Run, arguments: tuple[str, ...], text: str) -> None:
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    assert text in " ".join(err.split())


def test_keys_are_made_once(run: Run, run_json: RunJson, tmp_path: Path) -> None:
    made = {"hand": f"{tmp_path}/keys/hand", "client": f"{tmp_path}/keys/client"}
    assert run_json("hand", "keys", "--out", tmp_path / "keys") == made
    assert run("hand", "keys", "--out", tmp_path / "keys")[0] == 2
    status, out, _ = run("hand", "keys", "--out", tmp_path / "keys", "--force")
    assert status == 0
    assert "--driver remote --driver-option keys=" in out


def test_serve_hand_with_keys(run: Run, tmp_path: Path) -> None:
    main_keys = tmp_path / "keys"
    assert run("hand", "keys", "--out", main_keys)[0] == 0
    with served("--driver", "sim", "--driver-option", "seed=4", "--keys", str(main_keys / "hand")) as (
        process,
        address,
    ):
        with GuardedHand(
            create_driver("remote", address=address, keys=str(main_keys / "client"), silence_s="30")
        ) as hand:
            for _ in range(20):
                hand.act(hand.nearest(hand.observe().q_desired_rad))
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "sim: ended after 1 clients" in err


@pytest.mark.parametrize(
    "command",
    [
        ("hand", "show", "HAND"),
        ("hand", "test", "sim", "--driver-option", "hand=HAND"),
        ("collect", "--driver", "sim", "--hand", "HAND", "--out", "run"),
        ("serve-hand", "--driver", "sim", "--driver-option", "hand=HAND"),
    ],
    ids=lambda command: " ".join(command[:2]),
)
def test_limits_that_no_finger_has_need_a_flag(
    run: Run, run_json: RunJson, tmp_path: Path, command: tuple[str, ...]
) -> None:
    folder = tmp_path / "hand"
    shutil.copytree(Path(skincal.robot.__file__).parent / "hands" / "dlr_hand_2", folder)
    path = folder / "hand.toml"
    path.write_text(path.read_text().replace("max_force_n = 10.0", "max_force_n = 1000.0"))
    status, out, err = run(*(part.replace("HAND", str(folder)) for part in command))
    assert (status, out) == (2, "")
    assert "max_force_n: expected at most 50 N; got 1000 N" in err
    assert "--beyond-limits" in err
    if command[1] == "show":
        assert run_json(*command[:2], folder, "--beyond-limits")["max_force_n"] == 1000.0
