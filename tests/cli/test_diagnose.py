"""``skincal diagnose`` as a user runs it, on small sessions of a simulated skin."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chambers import Chamber
from commands import captured, run
from report.diagnosis_cases import LOOP, calibration, session, without_frames
from rich.console import Console

from skincal.calibration import read_calibration, write_calibration
from skincal.dataset import dataset_hash, read_dataset, write_dataset
from skincal.progress import stage_shown


def hashes(folder: Path) -> dict[str, str]:
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.iterdir())}


@pytest.fixture
def cal(tmp_path: Path) -> Path:
    write_calibration(calibration(), tmp_path / "cal")
    return tmp_path / "cal"


@pytest.fixture
def looped(tmp_path: Path) -> Path:
    write_dataset(session(LOOP), tmp_path / "run")
    return tmp_path / "run"


@pytest.mark.slow
def test_named_added_and_used(cal: Path, looped: Path, tmp_path: Path):
    before = hashes(cal)
    command = [sys.executable, "-m", "skincal", "diagnose", looped, cal, "--out", tmp_path / "new", "--json"]
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["verdict"] == "effects"
    (effect,) = told["effects"]
    assert effect["name"] == "hysteresis"
    assert effect["name"] in effect["consistent_with"]
    assert effect["p_value"] <= 0.01
    assert effect["parameters"]["height"] == pytest.approx(0.6, abs=0.1)
    gap = told["gap"]
    assert gap["heldout_rmse_before"] > gap["heldout_rmse_after"]
    assert gap["heldout_rmse_after"] == pytest.approx(gap["noise_floor_rmse"], rel=0.1)
    assert "unloading" in told["where"]
    assert "shear" in told["cannot_see"]
    assert json.loads((tmp_path / "new" / "diagnosis.json").read_text(encoding="utf-8")) == told
    assert {"report.html", "gap.png", "signature.png"} <= {p.name for p in (tmp_path / "new").iterdir()}
    assert hashes(cal) == before, "CAL is untouched"
    _is_a_calibration_like_any_other(tmp_path, looped, cal)


def _is_a_calibration_like_any_other(folder: Path, data: Path, cal: Path) -> None:
    new = read_calibration(folder / "new")
    assert [e.name for e in new.effects] == ["hysteresis"]
    assert new.provenance.command is not None
    assert "diagnose" in new.provenance.command
    old = read_calibration(cal)
    assert new.provenance.dataset_sha256 == dataset_hash(data)
    assert new.provenance.extra["calibrated_on_sha256"] == old.provenance.dataset_sha256
    assert new.loss.mse_counts2 < 0.5 * old.loss.mse_counts2
    assert new.slack is not None and len(new.slack["press"]) == len(read_dataset(data).presses)
    errors: list[float] = []
    for name, of in (("old", cal), ("better", folder / "new")):
        assert run("predict", of, data, "--out", folder / name, "--slack") == 0
        predicted, measured = read_dataset(folder / name).frames, read_dataset(data).frames
        assert predicted is not None and measured is not None
        errors.append(float(np.sqrt(((predicted.counts - measured.counts)[measured.press >= 0] ** 2).mean())))
    assert errors[1] < 0.7 * errors[0]
    assert run("export-dr", folder / "new", "--out", folder / "ranges.toml") == 0
    assert "[skin.effects.hysteresis.height]" in (folder / "ranges.toml").read_text(encoding="utf-8")
    assert run("diagnose", data, folder / "new", "--out", folder / "again", "--no-report", "--json") == 0
    assert read_calibration(folder / "again").effects[0].name == "hysteresis"


def test_nothing_hidden(cal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_dataset(session(presses=16), tmp_path / "run")
    assert run("diagnose", tmp_path / "run", cal, "--out", tmp_path / "new", "--no-report") == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[0] == "These presses show no missing effect."
    assert "these presses cannot show: shear" in out
    assert str(tmp_path / "new") in err
    told = json.loads((tmp_path / "new" / "diagnosis.json").read_text(encoding="utf-8"))
    assert (told["verdict"], told["effects"], told["gap"]["closed"]) == ("none", [], None)
    assert not (tmp_path / "new" / "report.html").exists()
    assert read_calibration(tmp_path / "new").model == read_calibration(cal).model


def test_static_presses_say_what_they_lack(cal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_dataset(without_frames(session(presses=16)), tmp_path / "run")
    arguments = ("diagnose", tmp_path / "run", cal, "--out", tmp_path / "new", "--no-report", "--json")
    assert run(*arguments) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["verdict"] == "none"
    assert {"hysteresis", "creep", "latency", "shear"} <= set(told["cannot_see"])
    assert "no frames" in told["why_not"]["creep"]


def test_other_sensor_and_too_few_presses(cal: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_dataset(session(presses=8), tmp_path / "few")
    file = cal / "calibration.toml"
    text = file.read_text(encoding="utf-8").replace("pitch_m = 0.004", "pitch_m = 0.005")
    file.write_text(text, encoding="utf-8")
    assert run("diagnose", tmp_path / "few", cal, "--out", tmp_path / "new") == 2
    assert "Use a calibration of this sensor" in capsys.readouterr().err
    write_calibration(calibration(), tmp_path / "good")
    assert run("diagnose", tmp_path / "few", tmp_path / "good", "--out", tmp_path / "new") == 1
    assert "Record more presses" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


Diagnose = Callable[..., tuple[Path, dict[str, Any]]]


@pytest.fixture
def chamber_diagnosis(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Diagnose:
    """Fits and diagnoses a chamber with unequal levels at rest; returns its dataset and the verdict as JSON."""

    def made(chamber: Chamber, *, frames: bool = True) -> tuple[Path, dict[str, Any]]:
        chamber.rest[:] = np.linspace(10.0, 20.0, 16)
        data, cal, new = (
            chamber.write(tmp_path / "chamber", frames=frames),
            tmp_path / "cal",
            tmp_path / "new",
        )
        status, out, err = captured(capsys, "fit", data, "--out", cal, "--no-report")
        assert status == 0 and "uniform pressure" in err and "scale_per_n" in out
        status, out, err = captured(capsys, "diagnose", data, cal, "--out", new, "--json", "--no-report")
        assert status == 0, err
        return data, json.loads(out)

    return made


def test_a_pressure_chamber_goes_the_whole_way(
    chamber_diagnosis: Diagnose, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    chamber = Chamber.plain(group=(0, 1, 2), stuck=(5,), noisy=(9,))
    data, found = chamber_diagnosis(chamber)
    assert found["verdict"] == "effects"
    assert [effect["name"] for effect in found["effects"]] == ["taxel_offset"]
    assert {finding["code"] for finding in found["findings"]} >= {"jump", "stuck_taxel", "noisy_taxel"}
    assert found["gap"]["closed"] > 0.7
    (offset,) = (e for e in read_calibration(tmp_path / "new").effects if e.name == "taxel_offset")
    # Levels beside the one that all taxels share.
    own = np.array(offset.parameters["offset_counts"])
    assert own - own.mean() == pytest.approx(chamber.rest - chamber.rest.mean(), abs=1.5)
    again = "fit", data, "--effects", tmp_path / "new", "--out", tmp_path / "again"
    status, _, err = captured(capsys, *again)
    assert status == 2 and "under uniform pressure" in err
    assert not (tmp_path / "again").exists()


@pytest.mark.slow
def test_memory_and_offsets_in_a_chamber(chamber_diagnosis: Diagnose):
    """A deviation that all taxels share is no error of the gauge."""
    _, found = chamber_diagnosis(Chamber.plain(memory=0.06, plateaus=16))
    sets = [set(effect["consistent_with"]) for effect in found["effects"]]
    assert any("taxel_offset" in one for one in sets)
    assert any(one & {"hysteresis", "creep", "baseline_drift"} for one in sets)
    assert found["gap"]["closed"] > 0.8


def test_noise_of_a_chamber_without_frames(chamber_diagnosis: Diagnose):
    """No taxel is untouched there, so what presses differ by is not taken for noise."""
    _, found = chamber_diagnosis(Chamber.plain(plateaus=10), frames=False)
    # Of means of ten frames with a noise of one count, rounded.
    assert found["gap"]["noise_floor_rmse"] == pytest.approx(0.33, rel=0.35)
    assert [effect["name"] for effect in found["effects"]] == ["taxel_offset"]


def test_a_terminal_shows_the_stage_and_how_long_it_all_has_been(monkeypatch: pytest.MonkeyPatch):
    shown = StringIO()
    terminal = Console(file=shown, force_terminal=True, color_system=None, width=40)
    monkeypatch.setattr("rich.console.Console", lambda **_: terminal)
    with stage_shown() as show_stage:
        show_stage("null sessions: layer 1 mm, layer 1.8 mm, layer 3 mm, [layer] 5 mm")
    lines = shown.getvalue()
    assert "0:00:00 null sessions: layer 1 mm" in lines
    assert "[layer] 5 mm" not in lines
