"""``skincal collect`` as a person runs it: plans, sessions, and what it says when something is wrong."""

from __future__ import annotations

import errno
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import Run, RunJson

from skincal.collect import Plan, PlannedPress, write_plan
from skincal.dataset import check_dataset, read_dataset

PLAN = """u_m,v_m,force_n,speed_m_per_s,hold_s,pose
0,0,2,0.04,0.3,A
0.002,0.001,0.5,0.04,0.3,A
0,0,2,0.04,0.3,A
"""

POSED = Plan(
    "posed",
    tuple(PlannedPress(*site, 0.04, 0.3) for site in ((0.0, 0.0, 2.0), (2e-3, 1e-3, 0.5), (0.0, 0.0, 2.0))),
    {"A": (0.0, 0.25, 0.83)},
)
"""With its pose: the search for poses takes longer than the presses."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plan.csv").write_text(PLAN)
    return tmp_path


def test_json_is_what_the_contract_says(here: Path, run_json: RunJson):
    told = run_json(
        "collect", "--driver", "sim", "--seed", "7", "--plan", "plan.csv", "--out", "run",
        "--truth", "truth.json", "--effect", "hysteresis=1",
    )  # fmt: skip
    assert told["presses"] == 3 and told["missed_target"] in (0, 1) and told["dataset"] == "run"
    assert check_dataset(Path("run")).errors == ()
    truth = json.loads(Path("truth.json").read_text())
    (effect,) = truth["effects"]
    assert truth["seed"] == 7 and (effect["name"], effect["strength"]) == ("hysteresis", 1.0)
    dataset = read_dataset(Path("run"))
    assert "sim, seed 7" in dataset.meta.source and "hysteresis=1" in dataset.meta.source
    assert dataset.meta.sensor.baseline == "raw"
    assert sorted(p.name for p in here.iterdir()) == ["plan.csv", "run", "truth.json"]


def test_the_simulated_hand_changes_its_cap_without_being_asked(here: Path, run: Run):
    press = POSED.presses[0]
    write_plan(replace(POSED, presses=(press, replace(press, indenter_radius_m=0.004))), here / "two.toml")
    status, _, err = run("collect", "--seed", "7", "--plan", "two.toml", "--out", "run", "--json")
    assert status == 0, err
    radii = read_dataset(Path("run")).presses.column("indenter_radius_m")
    assert radii is not None and np.isnan(radii[0]) and radii[1] == 0.004


def test_same_seed_same_dataset(here: Path, run: Run):
    write_plan(replace(POSED, presses=POSED.presses[:1]), here / "plan.toml")
    for name in ("one", "two"):
        assert run("collect", "--seed", "3", "--plan", "plan.toml", "--out", name)[0] == 0
    assert Path("one/presses.csv").read_bytes() == Path("two/presses.csv").read_bytes()


def test_plan_only_moves_nothing(here: Path, run: Run, run_json: RunJson):
    told = run_json("collect", "--seed", "7", "--out", "run", "--plan-only")
    assert told["presses"] == 97 and told["kinds"]["repeat"] == 20 and told["seconds"] < 330
    assert sorted(p.name for p in here.iterdir()) == ["plan.csv", "run-plan.png", "run-plan.toml"]
    # The plan that was shown can be given back.
    assert run_json("collect", "--plan", "run-plan.toml", "--out", "again", "--plan-only")["presses"] == 97
    assert run("collect", "--seed", "7", "--out", "run", "--plan-only")[0] == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--protocol", "quick"], "--protocol: expected one of paper, full"),
        (["--driver", "none"], '"none"'),
        (["--effect", "hysteresis"], "--effect: expected NAME=STRENGTH"),
        (["--effect", "hysterese=1"], "hysteres"),
        (["--driver-option", "sed=3"], "seed"),
        (["--driver-option", "seed=3"], "--driver-option"),
        (["--hand", "nobody"], "nobody"),
        (["--plan", "none.toml"], "none.toml"),
        (["--second-indenter-mm", "4", "--protocol", "paper"], "--second-indenter-mm"),
        (["--plan", "none.toml", "--protocol", "full"], "a protocol or a plan"),
    ],
)
def test_a_wrong_command_line_is_status_2_and_leaves_nothing(
    here: Path, run: Run, arguments: list[str], message: str
):
    status, _, err = run("collect", "--out", "run", *arguments)
    assert status == 2 and message in err and "Traceback" not in err
    assert [p.name for p in here.iterdir()] == ["plan.csv"]


def test_a_full_disk_stops_the_hand_and_says_so(here: Path, run: Run, monkeypatch: pytest.MonkeyPatch):
    from skincal.collect.journal import Journal

    def full(self: Journal, number: int, arrays: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "press.npz")

    monkeypatch.setattr(Journal, "keep_press", full)
    write_plan(POSED, here / "plan.toml")
    status, _, err = run("collect", "--plan", "plan.toml", "--out", "run")
    assert status == 1 and "No space left on device" in err
    assert "ended early. The hand was stopped. No press was finished." in err


def test_lost_driver_is_reported_and_session_resumes(here: Path, run: Run, monkeypatch: pytest.MonkeyPatch):
    from skincal.hand.sim import SimDriver

    observe, count = SimDriver.observe, iter(range(10**6))

    def cut(self: SimDriver) -> object:
        if next(count) == 750:
            raise ConnectionError("the network is gone")
        return observe(self)

    monkeypatch.setattr(SimDriver, "observe", cut)
    write_plan(POSED, here / "plan.toml")
    command = ["collect", "--seed", "2", "--plan", "plan.toml", "--truth", "truth.json", "--out", "run"]
    status, _, err = run(*command)
    assert status == 1
    before = json.loads(Path("truth.json").read_text())["session"]["contacts"]
    assert "the network is gone" in err and "finished presses are saved" in err and "same command" in err
    status, _, err = run(*command[:2], "9", *command[3:])
    assert status == 2 and "--restart" in err and "seed" in err
    status, out, err = run(*command)
    assert status == 0 and "come from the interrupted session" in err and "3 presses" in out
    # The skin remembers what touched it before.
    after = json.loads(Path("truth.json").read_text())["session"]["contacts"]
    assert after > before > 0
    assert check_dataset(Path("run")).errors == ()
