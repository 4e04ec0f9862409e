"""A stage with a load cell: presses without a hand, and a guard of its own."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import run

from skincal.collect import Collected, Progress, collect
from skincal.collect.plan import Plan, PlannedPress
from skincal.collect.session import Watch
from skincal.collect.stage import stage_plan
from skincal.dataset import HOLD, read_dataset
from skincal.dataset.folder import Check
from skincal.errors import InputError, Problem, WorkError
from skincal.hand import HandError, StageDescription, StageState, create_driver, create_rig
from skincal.hand.stage_sim import StageSim

DRIVER = "skincal.hand.stage_sim:StageSim"
PLAN = Plan(
    "three",
    (
        PlannedPress(0.0, 0.0, 2.0, 0.02, 0.5),
        PlannedPress(2e-3, -1e-3, 4.0, 0.02, 0.5),
        PlannedPress(-3e-3, 2e-3, 1.0, 0.02, 0.5),
    ),
)


def session(folder: Path, stage: StageSim | None = None, watch: Watch | None = None) -> Collected:
    """Makes the presses of the plan with a stage."""
    stage = stage or StageSim(seed=2)
    rig = stage.description
    return collect(stage_plan(PLAN, rig), rig, lambda _: stage, folder / "run", watch=watch)


def test_presses_are_made_at_their_place_and_force(tmp_path: Path) -> None:
    found = session(tmp_path)
    data = read_dataset(tmp_path / "run")
    assert found.statuses == {"ok": 3}
    assert data.presses.force_n == pytest.approx([2.0, 4.0, 1.0], rel=0.04)
    assert data.presses.position_m[:, :2] == pytest.approx(PLAN.sites_m(), abs=20e-6)
    assert data.presses.column("q_0") is None
    assert data.frames is not None
    for number in range(3):
        held = (data.frames.phase == HOLD) & (data.frames.press == number)
        assert data.frames.force_n[held][5:] == pytest.approx(data.presses.force_n[number], abs=0.1)


def test_progress_is_reported_in_every_period(tmp_path: Path) -> None:
    seen: list[Progress] = []
    session(tmp_path, watch=seen.append)
    assert sorted({one.done for one in seen}) == [0, 1, 2, 3]
    assert {one.doing for one in seen} == {"idle", "load", "hold", "unload"}
    assert (np.diff([one.sample.time_s for one in seen]) > 0).all()
    held = [one for one in seen if one.doing == "hold"]
    assert [one.sample.force_n for one in held] == pytest.approx(
        [one.planned.force_n for one in held], rel=0.1
    )


class Weary(StageSim):
    """A stage that fails."""

    left = 700

    def observe(self) -> StageState:
        self.left -= 1
        if self.left < 0:
            raise OSError("the cable is out")
        return super().observe()


def test_an_interrupted_session_goes_on(tmp_path: Path) -> None:
    with pytest.raises(HandError, match="the cable is out"):
        session(tmp_path, Weary(seed=2))
    found = session(tmp_path)
    assert 0 < found.resumed < 3
    assert found.statuses == {"ok": 3}
    assert found.dataset.frames is not None
    assert (np.diff(found.dataset.frames.time_s) > 0).all()


def test_a_session_goes_on_with_the_same_stage_only(tmp_path: Path) -> None:
    class Other(StageSim):
        @property
        def description(self) -> StageDescription:
            rig = super().description
            return replace(rig, meta=replace(rig.meta, indenter=replace(rig.meta.indenter, radius_m=0.008)))

    with pytest.raises(HandError):
        session(tmp_path, Weary(seed=2))
    with pytest.raises(InputError, match="to be this one: stage simulated stage"):
        session(tmp_path, Other(seed=2))


@pytest.mark.parametrize(
    "press", [PlannedPress(0.05, 0.0, 2.0, 0.02, 0.5), PlannedPress(0.0, 0.0, 12.0, 0.02, 0.5)]
)
def test_what_a_stage_cannot_do_is_said_before_it_moves(press: PlannedPress) -> None:
    with pytest.raises(InputError):
        stage_plan(Plan("one", (press,)), StageSim().description)


def test_a_stage_is_no_hand() -> None:
    assert isinstance(create_rig(DRIVER, seed=1), StageSim)
    with pytest.raises(InputError, match="one of a stage"):
        create_driver(DRIVER, seed=1)


def test_the_file_of_truth_takes_the_place_of_no_strangers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plan, notes = Path("p.toml"), Path("notes.json")
    plan.write_text('format = "skincal-plan/1"\nname = "x"\n[[press]]\nu_m = 0\nv_m = 0\nforce_n = 1\n')
    notes.write_text("mine")
    assert (
        run("collect", "--driver", DRIVER, "--plan", plan, "--out", "run", "--force", "--truth", notes) == 2
    )
    assert notes.read_text() == "mine"


def test_the_command_collects_with_a_stage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plan.csv").write_text(
        "u_m,v_m,force_n,speed_m_per_s,hold_s\n0,0,2,0.02,0.5\n0.002,0,3,0.02,0.5\n"
    )
    out = tmp_path / "run"
    assert run("collect", "--driver", DRIVER, "--plan", tmp_path / "plan.csv", "--out", out, "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["presses"] == 2
    assert "stage" in read_dataset(out).meta.source


@pytest.mark.parametrize(("axis", "value"), [("upper_m", 0.003), ("lower_m", 0.001)])
def test_a_travel_that_does_not_span_the_skin_is_refused(tmp_path: Path, axis: str, value: float) -> None:
    class Low(StageSim):
        @property
        def description(self) -> StageDescription:
            rig = super().description
            return replace(rig, **{axis: np.array([*getattr(rig, axis)[:2], value])})

    with pytest.raises(InputError, match="travel along z"):
        session(tmp_path, Low())


def test_a_load_cell_that_stands_ends_the_press(tmp_path: Path) -> None:
    class Stuck(StageSim):
        held = 0.0
        deepest_m = 0.0

        def observe(self) -> StageState:
            state = super().observe()
            self.held = self.held or (state.force_n if state.force_n > 0.15 else 0.0)
            self.deepest_m = min(self.deepest_m, float(state.position_m[2]))
            return replace(state, force_n=self.held or state.force_n)

    stage = Stuck(seed=2)
    with pytest.raises(WorkError, match="load cell") as failed:
        session(tmp_path, stage)
    assert stage._halted  # pyright: ignore[reportPrivateUsage]
    assert any("stopped" in note for note in failed.value.__notes__)
    assert stage.deepest_m > -2e-3


@pytest.mark.parametrize(("factor", "text"), [(0.0, "a force that grows"), (-1.0, "The sign is wrong")])
def test_a_load_cell_that_does_not_answer_contact_ends_the_session(
    tmp_path: Path, factor: float, text: str
) -> None:
    class Blind(StageSim):
        true_n = 0.0

        def observe(self) -> StageState:
            state = super().observe()
            self.true_n = max(self.true_n, state.force_n)
            return replace(state, force_n=factor * state.force_n)

    stage = Blind(seed=2)
    with pytest.raises(WorkError, match=text):
        session(tmp_path, stage)
    assert 0.1 < stage.true_n < 5.0


def test_a_session_that_cannot_be_fitted_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        "skincal.collect.collection.check_dataset", lambda _: Check((Problem("x", "a", "b"),), (), None)
    )
    (tmp_path / "plan.csv").write_text("u_m,v_m,force_n,speed_m_per_s,hold_s\n0,0,2,0.02,0.5\n")
    assert run("collect", "--driver", DRIVER, "--plan", tmp_path / "plan.csv", "--out", tmp_path / "r") == 1
    assert "can be fitted" in capsys.readouterr().err
