"""The benchmark of a fit's speed measures a fit, and writes what it found."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import fit_speed
from benchmarks.sessions import make_session
from skincal.dataset import write_dataset

COARSE = ["--y-step-mm", "4", "--arc-step-mm", "2.5", "--alpha-step-deg", "20", "--e-count", "4"]


@pytest.mark.slow
def test_a_fit_is_timed_as_a_process_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_dataset(make_session(np.random.default_rng(5), presses=30)[0], tmp_path / "run")
    out = tmp_path / "speed.json"
    options = [*COARSE, "--no-report", "--workers", "1"]
    assert fit_speed.main([str(tmp_path / "run"), "--out", str(out), "--", *options]) == 0
    found = json.loads(out.read_text())
    assert found == json.loads(capsys.readouterr().out)
    assert found["combinations"] == 3 * 3 * 3 * 4
    assert found["presses"] > 5
    assert 1.0 < found["processor time [s]"] < 300.0
    assert found["command"].startswith("skincal fit ") and found["command"].endswith("--workers 1")
