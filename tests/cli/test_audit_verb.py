"""``skincal audit`` as a user runs it."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import commands
import pytest
from calibrations import on_a_plane
from commands import RunJson
from diagnosis.diagnose_data import still

from skincal.calibration import write_calibration
from skincal.dataset import write_dataset
from skincal.effects import EFFECTS

PLAN = "u_m,v_m,force_n,speed_m_per_s,hold_s\n" + "\n".join(
    f"{0.001 * (k % 5 - 2)},{0.001 * (k // 5 - 2)},{1 + 0.1 * k},{0.016 if k % 2 else 0.04},0.5"
    for k in range(20)
)


@pytest.fixture
def static(tmp_path: Path) -> Path:
    write_dataset(still(), tmp_path / "data")
    return tmp_path / "data"


run = partial(commands.run, "audit")


def test_table_says_what_is_seen_and_why_not(static: Path, capsys: pytest.CaptureFixture[str]):
    assert run(static) == 0
    out = capsys.readouterr().out
    assert "16 presses, 16 images (hold means) of 16 taxels" in out
    assert "are assumed" in out and "crosstalk" in out
    assert "no frames: only the mean of each hold was recorded" in out


def test_json_and_picture(static: Path, cal: Path, tmp_path: Path, run_json: RunJson):
    arguments = (static, "--calibration", cal, "--out", tmp_path / "out")
    found = run_json("audit", *arguments)
    assert found["calibrated"] and not found["planned"]
    assert {e["name"] for e in found["effects"]} == set(EFFECTS)
    creep = next(e for e in found["effects"] if e["name"] == "creep")
    assert creep["smallest_strength"] is None and creep["reason"] and not creep["visible"]
    assert sorted(found["visible"] + found["cannot_see"]) == sorted(EFFECTS)
    assert (tmp_path / "out" / "audit.png").stat().st_size > 10_000
    assert run(*arguments, "--json") == 2, "nothing is overwritten without --force"


def test_plan_without_data(tmp_path: Path, run_json: RunJson):
    (tmp_path / "mine.csv").write_text(PLAN)
    found = run_json("audit", tmp_path / "mine.csv")
    assert found["planned"] and found["presses"] == 20 and found["frames"]
    assert "hysteresis" in found["visible"] and "shear" in found["cannot_see"]


def test_errors_are_said(static: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert run(tmp_path / "nowhere") == 2
    assert run(tmp_path / "nowhere.toml") == 2
    assert "no such file" in capsys.readouterr().err
    assert run(static, "--hand", "dlr_hand_2") == 2
    assert "Leave --hand out" in capsys.readouterr().err
    write_calibration(on_a_plane(), tmp_path / "plane")
    assert run(static, "--calibration", tmp_path / "plane") == 2
    assert "as calibrated" in capsys.readouterr().err
