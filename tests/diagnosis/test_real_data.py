"""Diagnosis of measured data: the effects and faults that are visible by eye."""

from __future__ import annotations

from pathlib import Path

import pytest

from skincal.calibrate import calibrate_uniform
from skincal.dataset import read_dataset
from skincal.diagnosis.diagnosis import summary
from skincal.diagnosis.workflow import diagnose


@pytest.mark.slow
def test_insole_effects_and_faults(shared: Path) -> None:
    """Falling pressure reads up to four counts higher than rising; a quarter of the taxels is noisy."""
    data = read_dataset(shared / "real" / "insole")
    found = summary(diagnose(data, calibrate_uniform(data).calibration))
    assert found["verdict"] == "effects"
    first, second = found["effects"][:2]
    assert first["name"] == "taxel_offset"
    assert second["name"] in ("creep", "hysteresis")
    assert {finding["code"] for finding in found["findings"]} >= {"jump", "stuck_taxel", "noisy_taxel"}
    gap = found["gap"]
    assert gap["closed"] > 0.95
    assert gap["heldout_rmse_after"] < 1.15 * gap["noise_floor_rmse"]
