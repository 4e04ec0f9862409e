"""Recordings in the form of eFlesh: magnetometers of three axes, and the robot's states with a gauge that is slower."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from skincal.dataset import HOLD, IDLE, check_dataset
from skincal.errors import InputError
from skincal.imports import Imported, import_csv, template

SHARED = Path(__file__).parents[3] / "shared" / "real" / "eflesh" / "normal_force"

TAXELS = """r,c,u_m,v_m,du_m,dv_m
0,0,0,0.006,0.004,0.004
0,1,-0.006,0,0.004,0.004
0,2,0,0,0.004,0.004
0,3,0.006,0,0.004,0.004
0,4,0,-0.006,0.004,0.004
"""


def bring(folder: Path, recording: Path) -> Imported:
    (folder / "eflesh.toml").write_text(template("eflesh"), encoding="utf-8")
    (folder / "taxels.csv").write_text(TAXELS)
    files = [recording / "sensor.csv", recording / "states.csv"]
    return import_csv(folder / "eflesh.toml", folder / "out", files)


def write_recording(folder: Path) -> np.ndarray:
    """Five presses in the published form; returns their greatest forces [N]."""
    rng = np.random.default_rng(0)
    time = 1_743_486_221.0 + np.cumsum(rng.uniform(0.03, 0.08, 1600))
    phase = (time - time[0]) / 20.0
    depth = np.clip(np.sin(2 * np.pi * phase), 0, 1)
    force_gf = 2000.0 * (1 + 0.1 * np.floor(phase)) * np.clip(depth * 1.15, 0, 1) ** 2
    gauge = np.where(np.arange(len(time)) % 2 == 1, -1.0, np.round(force_gf, 2))
    place = np.column_stack([np.full(len(time), 315.0), np.full(len(time), -100.0), 288.0 - 12 * depth])
    axes = rng.normal(size=(5, 3)) * 800
    field = (force_gf[:, None, None] / 2000 * axes + rng.uniform(-9000, 9000, (5, 3))).reshape(len(time), 15)
    pd.DataFrame(np.column_stack([time, field + rng.normal(0, 2, field.shape)])).to_csv(
        folder / "sensor.csv", index=False, header=False
    )
    pd.DataFrame(np.column_stack([time + 0.0025, place, gauge])).to_csv(
        folder / "states.csv", index=False, header=False
    )
    return np.array([force_gf[np.floor(phase) == k].max() for k in range(5)]) * 9.80665e-3


def test_published_form_imports(tmp_path: Path):
    force = write_recording(tmp_path)
    done = bring(tmp_path, tmp_path)
    checked = check_dataset(tmp_path / "out")
    assert checked.dataset is not None and not [p for p in checked.warnings if p.code]
    np.testing.assert_allclose(checked.dataset.presses.force_n, force, rtol=0.05)
    assert (checked.dataset.presses.counts > 100).all()
    assert "force_n.unit" in done.assumed and "position.depth" in done.assumed
    assert checked.dataset.meta.sensor.unit == "uT"


@pytest.mark.skipif(not SHARED.is_dir(), reason="the recordings are not here")
@pytest.mark.parametrize("folder", sorted(SHARED.glob("*/")), ids=lambda path: path.name)
def test_recordings_of_eflesh(tmp_path: Path, folder: Path):
    done = bring(tmp_path, folder)
    checked = check_dataset(tmp_path / "out")
    assert checked.dataset is not None and checked.dataset.frames is not None
    assert len(checked.dataset.presses) == 10
    assert not [problem for problem in (*done.warnings, *checked.warnings) if problem.code]
    frames = checked.dataset.frames
    assert frames.counts[frames.phase == HOLD].mean() > 10 * frames.counts[frames.phase == IDLE].mean()
    # Gauge and magnetometers saw the same contacts.
    (clock,) = done.clocks
    assert clock.correlation > 0.98


def test_unknown_template():
    with pytest.raises(InputError, match='Did you mean "eflesh"'):
        template("eflsh")
