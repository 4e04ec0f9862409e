"""``skincal diagnose --collect``: presses of the same hand, rounds that are kept, one session at the end."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrations import make_calibration

from skincal.calibration import read_calibration, write_calibration
from skincal.cli.main import main
from skincal.collect import Mount, Plan, PlannedPress, collect
from skincal.collect.rig import Rig
from skincal.collect.rounds import SESSION, Rounds
from skincal.dataset import Dataset, read_dataset
from skincal.dataset.dataset import GAP_S
from skincal.diagnosis.observed import observe
from skincal.diagnosis.updated_calibration import updated_parameters
from skincal.errors import InputError
from skincal.files import alone
from skincal.hand.sim import SimDriver
from skincal.inference.constants import CONSTANTS
from skincal.inference.start import fit_base

SEED = 7
SOURCE = f"skincal collect: driver sim, seed {SEED}, plan few"


def plan(count: int, first: int = 0) -> Plan:
    """Quick presses at places of their own, with their pose: the search for poses takes longer than the presses."""
    own = [
        PlannedPress(1.5e-3 * (k % 4) - 2e-3, 2e-3 * (k // 4), 1.0, 4e-3, 0.3)
        for k in range(first, first + count)
    ]
    return Plan("few", tuple(own), {"A": (0.0, 0.25, 0.83)})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Three presses of the simulated hand."""
    folder = tmp_path_factory.mktemp("hand")
    hand = SimDriver(seed=SEED).description
    assert Mount.of(hand.meta)
    collect(plan(3), hand, lambda _: SimDriver(seed=SEED), folder / "run", source=SOURCE)
    return read_dataset(folder / "run")


def never(*_: object, **__: object) -> None:
    raise AssertionError("pressed again, or asked for another cap")


def rounds(out: Path, data: Dataset, seed: int = SEED, driver: str = "sim") -> Rounds:
    rig = Rig.of(driver, None, seed)

    def press(plan: Plan, folder: Path, source: str, start_s: float) -> None:
        rig.press(plan, folder, source, start_s=start_s, change_cap=never)

    return Rounds.of(out, data, rig, press)


def test_a_round_is_pressed_once_and_joins_the_session(run: Dataset, tmp_path: Path, monkeypatch):
    own = rounds(tmp_path / "new", run)
    both = own.press(run, plan(2, 4), 1)
    assert len(both.presses) == 5 and both.sha256 is not None
    assert both.frames is not None and run.frames is not None
    assert (np.diff(both.frames.time_s) > 0).all()
    later = both.frames.time_s[len(run.frames)] - run.frames.time_s[-1]
    assert 0 < later <= GAP_S + 1e-6
    assert both.frames.counts[: len(run.frames)] == pytest.approx(run.frames.counts)

    monkeypatch.setattr(Rig, "press", never)
    again = rounds(tmp_path / "new", run)
    assert again.press(run, plan(2, 4), 1).presses.press.tolist() == both.presses.press.tolist()
    assert again.saved == 1
    again.keep_in(tmp_path, 2, 1)
    assert len(read_dataset(tmp_path / SESSION).presses) == 5
    again.done()
    assert not again.folder.exists()


def test_another_hand_is_refused(run: Dataset, tmp_path: Path):
    with pytest.raises(InputError, match="Give --seed 7"):
        rounds(tmp_path / "new", run, seed=0)
    with pytest.raises(InputError, match="a hand"):
        rounds(tmp_path / "new", run, driver="stage-sim")


def test_interrupted_run_of_another_command(run: Dataset, tmp_path: Path):
    own = rounds(tmp_path / "new", run)
    own.folder.mkdir()
    (own.folder / "key.json").write_text('{"dataset": "another"}', encoding="utf-8")
    with pytest.raises(InputError, match="another one"):
        rounds(tmp_path / "new", run)


def test_an_interrupted_run_goes_on_with_the_same_hand_only(run: Dataset, tmp_path: Path):
    own = rounds(tmp_path / "new", run)
    own.folder.mkdir()
    (own.folder / "key.json").write_text(json.dumps({**own.key, "hand": "another"}), encoding="utf-8")
    with pytest.raises(InputError, match="another one"):
        rounds(tmp_path / "new", run)
    with pytest.raises(InputError, match="another one"):
        own.press(run, plan(2, 4), 1)


def test_two_processes_do_not_press_at_once(run: Dataset, tmp_path: Path):
    own = rounds(tmp_path / "new", run)
    with (
        alone(tmp_path / ".new.rounds.lock", own.folder, create=True),
        pytest.raises(InputError, match="another process at work"),
    ):
        own.press(run, plan(2, 4), 1)
    assert not own.folder.exists()


def test_a_session_of_no_simulated_hand_is_not_compared(run: Dataset, tmp_path: Path):
    other = replace(run, meta=replace(run.meta, source="a bench"))
    assert rounds(tmp_path / "new", other, seed=3).rig.seed == 3


def test_unjoinable_dataset_is_refused_first(run: Dataset, tmp_path: Path):
    with pytest.raises(InputError, match="with frames"):
        rounds(tmp_path / "new", replace(run, frames=None))
    sensor = replace(run.meta.sensor, value_max=99)
    with pytest.raises(InputError, match="sensor"):
        rounds(tmp_path / "new", replace(run, meta=replace(run.meta, sensor=sensor)))


@pytest.mark.slow
def test_rounds_end_with_the_budget_and_are_one_session(tmp_path: Path, monkeypatch, capsys):
    """All twelve presses are made where they distinguish nothing, and the calibration uses them all."""
    hand = SimDriver(seed=SEED).description
    data = collect(
        Plan("few", plan(16).presses),
        hand,
        lambda _: SimDriver(seed=SEED, effects={"hysteresis": 1.0}),
        tmp_path / "run",
        source=SOURCE,
    ).dataset
    fitter = observe(data, None, np.random.default_rng(0), keep=False).fitter
    meta, state = data.meta, fit_base(fitter, start_is_calibrated=False).state
    blank = make_calibration(
        sensor=meta.sensor, surface=meta.surface, indenter=meta.indenter, mount=meta.mount
    )
    model = updated_parameters(blank, state)
    known = {name: (value, value) for name, value in model.best().items()}
    cal = replace(blank, model=model, intervals=known, draws=None, grid=None, slack=None, findings=())
    write_calibration(cal, tmp_path / "cal")
    # Every candidate that is fitted in full is a rival, whatever the presses say.
    monkeypatch.setattr("skincal.inference.search.C", replace(CONSTANTS, alike=1e9, contend=0.0))
    new = tmp_path / "new"
    command = ["diagnose", tmp_path / "run", tmp_path / "cal", "--out", new, "--collect", "--driver", "sim"]
    command += ["--seed", SEED, "--effect", "hysteresis=1", "--json", "--no-report"]
    with pytest.raises(SystemExit) as ended:
        main([*map(str, command)])
    printed = capsys.readouterr()
    assert not ended.value.code, printed.err
    told = json.loads(printed.out)
    assert told["verdict"] == "effects" and len(told["effects"][0]["consistent_with"]) > 1
    assert told["collected"]["presses"] == 12 and told["collected"]["rounds"] == 3
    assert not told["collected"]["settled"]
    assert (
        "round 1: 4 presses, to distinguish" in printed.err and "round 3: with 12 more presses" in printed.err
    )
    session = read_dataset(new / SESSION)
    assert len(session.presses) == 28
    assert read_calibration(new).provenance.dataset_sha256 == session.sha256
    assert not (tmp_path / ".new.rounds").exists()
