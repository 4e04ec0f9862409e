"""``skincal predict`` as a user runs it."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import commands
import numpy as np
import pytest
from calibrations import make_calibration
from commands import RunJson

from skincal.calibration import Effect, write_calibration
from skincal.dataset import read_dataset, write_dataset

run = partial(commands.run, "predict")


def test_presses_and_frames(
    cal: Path, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(cal, folder, "--out", tmp_path / "out") == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert "12 presses predicted" in err
    assert "96 frames predicted" in err
    assert "moved by" not in err
    predicted, measured = read_dataset(tmp_path / "out"), read_dataset(folder)
    assert predicted.frames is not None and measured.frames is not None
    np.testing.assert_array_equal(predicted.presses.position_m, measured.presses.position_m)
    assert predicted.presses.counts.max() > 20
    assert "the calibration cal (fitted to paper" in predicted.meta.source
    assert (tmp_path / "out" / "frames.csv").is_file(), "tables keep their format"


def test_json(cal: Path, folder: Path, tmp_path: Path, run_json: RunJson) -> None:
    answer = run_json("predict", cal, folder, "--out", tmp_path / "out", "--slack")
    assert answer["dataset"] == str(tmp_path / "out")
    assert (answer["presses"], answer["frames"]) == (12, 96)
    measured, predicted = read_dataset(folder), read_dataset(tmp_path / "out")
    difference = measured.presses.counts - predicted.presses.counts
    assert answer["rmse_counts"] == pytest.approx(np.sqrt(np.mean(difference**2)))
    moved = predicted.presses.position_m - measured.presses.position_m
    assert answer["slack_rms_m"] == pytest.approx(np.sqrt((moved**2).sum(axis=1).mean() / 2), rel=0.05)
    assert set(answer) == {
        "dataset", "presses", "frames", "rmse_counts", "rmse_with_rest_counts", "frames_rmse_counts",
        "frames_rmse_with_rest_counts", "slack_rms_m", "abstaining",
    }  # fmt: skip


def test_without_frames(cal: Path, folder: Path, tmp_path: Path, run_json: RunJson) -> None:
    write_dataset(replace(read_dataset(folder), frames=None), tmp_path / "static", presses_as="parquet")
    answer = run_json("predict", cal, tmp_path / "static", "--out", tmp_path / "out")
    assert (answer["frames"], answer["frames_rmse_counts"], answer["slack_rms_m"]) == (0, None, None)
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        ".skincal.json",
        "dataset.toml",
        "presses.parquet",
    ]


def test_effects_are_included_and_one_that_abstains_is_said(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    effects = (Effect("creep", {"amplitude": 0.3}), Effect("rate", {"exponent": 0.2}))
    for name, some in (("base", ()), ("creep", effects[:1]), ("both", effects)):
        write_calibration(make_calibration(effects=some), tmp_path / name)
        assert run(tmp_path / name, folder, "--out", tmp_path / f"of_{name}", "--json") == 0
        out, err = capsys.readouterr()
        assert json.loads(out)["abstaining"] == ({"rate": ["speed"]} if name == "both" else {})
        assert ("for the effect rate: expected speed_m_per_s; got none" in err) == (name == "both")
    base, creep, both = (read_dataset(tmp_path / f"of_{name}") for name in ("base", "creep", "both"))
    assert creep.presses.counts.max() > 1.1 * base.presses.counts.max()
    np.testing.assert_array_equal(both.presses.counts, creep.presses.counts)
    assert "effects creep, contact positions as measured" in both.meta.source
