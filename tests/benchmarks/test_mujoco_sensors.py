from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from benchmarks import mujoco_sensors
from benchmarks.model_speed import finger_patch


def test_missing_package_is_said():
    code = "import sys; sys.modules['mujoco'] = None; from benchmarks import mujoco_sensors as m; sys.exit(m.main([]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "pip install mujoco" in done.stderr


def test_sensors_feel_the_ball_where_it_is():
    mujoco = pytest.importorskip("mujoco")
    finger, patch = finger_patch()
    places, _ = finger.wrap(mujoco_sensors.POSE, patch.layout.centres_m)
    found = mujoco_sensors.measure(mujoco, 4)["sensors"]
    assert len(places) == 16
    for sensor in found.values():
        assert sensor["presses without an image"] == 0
        assert sensor["centroid, RMS error [mm]"] < 3
    assert found["MuJoCo's touch grid"]["taxels that answer"] == 1
    assert np.isfinite(found["skincal"]["us an image"])
