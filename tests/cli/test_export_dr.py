"""``skincal export-dr`` as a user runs it."""

import json
from functools import partial
from typing import get_args

import commands
import pytest
from calibrations import INTERVALS, make_calibration

from skincal.calibration import Effect, write_calibration
from skincal.ranges import PRESETS, preset, read_ranges
from skincal.tasks import PresetName

run = partial(commands.run, "export-dr")


def test_the_default(cal, tmp_path, capsys):
    out = tmp_path / "ranges.toml"
    assert run(cal, "--out", out) == 0
    ranges = read_ranges(out)
    assert ranges["skin.y_m"].source == "calibrated"
    assert ranges["finger.k_p_nm_per_rad"] == preset("iros24")["finger.k_p_nm_per_rad"]
    assert ranges.joint is None
    shown, said = capsys.readouterr()
    lines = [line.split() for line in shown.splitlines()]
    assert ["y_m", "0.02175", "…", "0.02525", "0.0215", "…", "0.0255", "88%"] in lines
    assert any(line[0] == "elasticity_pa_per_m" and line[-1] == "100%" for line in lines if line)
    assert "5 parameters calibrated, 25 assumed from iros24" in shown
    assert said == "skincal: warning of the calibration: beta_deg ends at 0. Search from below 0.\n"


def test_effects_are_ranges(tmp_path, capsys):
    gains = tuple(0.9 + 0.01 * j for j in range(16))
    effects = (
        Effect("hysteresis", {"height": 0.4}, {"height": (0.3, 2.5)}),
        Effect("taxel_gain", {"gain": gains}, {"gain": ((0.8,) * 16, (1.2,) * 16)}),
        Effect("indenter_radius", {"scale": 0.8}, {"scale": (0.7, 0.9)}),
    )
    write_calibration(make_calibration(effects=effects), tmp_path / "cal")
    assert run(tmp_path / "cal", "--out", tmp_path / "r.toml", "--json") == 0
    shown, said = capsys.readouterr()
    answer = json.loads(shown)["calibrated"]
    assert answer["skin.effects.hysteresis.height"] == {"low": 0.3, "high": 1.5, "of_preset": None}
    assert answer["skin.effects.taxel_gain.gain"]["low"] == [0.8] * 16
    assert "indenter_radius: expected an effect of the skin; got an error of what the rig measured" in said
    assert read_ranges(tmp_path / "r.toml")["skin.effects.taxel_gain.gain"].high == (1.2,) * 16
    assert run(tmp_path / "cal", "--out", tmp_path / "r.yaml") == 0
    assert "16 ranges" in capsys.readouterr()[0]


def test_json(cal, tmp_path, run_json):
    arguments = ("--preset", "icra26", "--joint", "--draws", 50)
    answer = run_json("export-dr", cal, "--out", tmp_path / "r.yaml", *arguments)
    assert answer["preset"] == "icra26"
    assert answer["ranges"] == str(tmp_path / "r.yaml")
    assert answer["joint_draws"] == 50
    assert answer["calibrated"]["skin.alpha_deg"] == pytest.approx(
        {"low": -15, "high": 10, "of_preset": 25 / 4.6}
    )
    assert answer["calibrated"]["skin.beta_deg"]["of_preset"] is None
    assert set(answer["calibrated"]) == {f"skin.{name}" for name in INTERVALS}
    assert "skin.noise_sigma_counts" in answer["assumed"]
    assert answer["findings"] == ["edge"]
    ranges = read_ranges(tmp_path / "r.yaml")
    assert len(ranges.joint) == 50
    assert set(answer["assumed"]) | set(answer["calibrated"]) == set(ranges)


def test_what_the_calibration_leaves_open_is_said(tmp_path, capsys):
    open_stiffness = INTERVALS | {"elasticity_pa_per_m": (-float("inf"), float("inf"))}
    write_calibration(make_calibration(intervals=open_stiffness, findings=()), tmp_path / "cal")
    assert run(tmp_path / "cal", "--out", tmp_path / "r.json", "--json") == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["warnings"][0]["place"] == "calibration.toml, [intervals] elasticity_pa_per_m"
    assert err.startswith(
        "skincal: warning: calibration.toml, [intervals] elasticity_pa_per_m: expected a bounded interval"
    )
    name = "skin.elasticity_pa_per_m"
    assert read_ranges(tmp_path / "r.json")[name] == preset("iros24")[name]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("missing", "--out", "r.toml"), "no such folder"),
        (("cal", "--out", "r.txt"), ".toml, .json, .yaml"),
        (("cal", "--out", "none/r.toml"), "mkdir -p none"),
        (("cal", "--out", "cal"), "ending in"),
        (("cal", "--out", "r.toml", "--preset", "iros25"), "iros24"),
        (("cal", "--out", "r.toml", "--draws", "0"), "draws"),
        (("cal",), "--out"),
    ],
)
def test_a_wrong_command_line_is_status_two(cal, tmp_path, capsys, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    shown, said = capsys.readouterr()
    assert shown == ""
    assert words in said
    assert "Traceback" not in said
    assert [p.name for p in tmp_path.iterdir()] == ["cal"]


def test_the_choices_are_the_presets():
    assert set(get_args(PresetName)) == set(PRESETS)


def test_an_unknown_scale_is_refused_unless_assumed(tmp_path, capsys):
    untold = {**INTERVALS, "scale_per_n": (float("-inf"), float("inf"))}
    write_calibration(make_calibration(intervals=untold), tmp_path / "cal")
    out = tmp_path / "r.toml"
    assert run(tmp_path / "cal", "--out", out) == 1
    assert "--assume-scale" in capsys.readouterr()[1]
    assert not out.exists()
    assert run(tmp_path / "cal", "--out", out, "--assume-scale", 80, 60) == 2
    assert run(tmp_path / "cal", "--out", out, "--assume-scale", 60, 80) == 0
    scale = read_ranges(out)["skin.scale_per_n"]
    assert (scale.low, scale.high, scale.source) == (60.0, 80.0, "assumed")
