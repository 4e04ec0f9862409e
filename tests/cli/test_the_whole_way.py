"""From pressing a simulated skin with something hidden to ranges of training, as a user goes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from skincal.calibration import read_calibration
from skincal.cli.main import main
from skincal.dataset import read_dataset

PLAN = Path(__file__).parents[2] / "data" / "short-plan.toml"
COARSE = ("--y-step-mm", "0.5", "--alpha-step-deg", "5", "--e-count", "12", "--workers", "1", "--no-report")


def run(*arguments: object) -> None:
    with pytest.raises(SystemExit) as ended:
        main([*map(str, arguments)])
    assert (ended.value.code or 0) == 0, arguments


@pytest.mark.slow
def test_collected_fitted_diagnosed_predicted_and_exported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SKINCAL_CACHE", str(tmp_path / "cache"))
    run(
        "collect", "--driver", "sim", "--seed", 7, "--plan", PLAN,
        "--effect", "hysteresis=1", "--truth", "truth.json", "--out", "run",
    )  # fmt: skip
    run("fit", "run", "--out", "cal", *COARSE)
    before = {p.name: p.read_bytes() for p in Path("cal").iterdir() if p.is_file()}
    capsys.readouterr()
    run("diagnose", "run", "cal", "--out", "better", "--no-report", "--json")
    told = json.loads(capsys.readouterr().out)
    assert told["verdict"] == "effects"
    assert "hysteresis" in told["effects"][0]["consistent_with"]
    assert told["gap"]["heldout_rmse_after"] < told["gap"]["heldout_rmse_before"]
    assert {p.name: p.read_bytes() for p in Path("cal").iterdir() if p.is_file()} == before
    name = told["effects"][0]["name"]
    assert name in [e.name for e in read_calibration(Path("better")).effects]
    run("predict", "better", "run", "--out", "said", "--slack")
    said, data = read_dataset(Path("said")), read_dataset(Path("run"))
    assert said.frames is not None and data.frames is not None and len(said.frames) == len(data.frames)
    run("export-dr", "better", "--out", "ranges.toml")
    assert f"[skin.effects.{name}." in Path("ranges.toml").read_text(encoding="utf-8")
