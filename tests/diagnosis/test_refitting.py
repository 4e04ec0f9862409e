"""Refitting the effects of one calibration together with the base model of another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from report.diagnosis_cases import LOOP, calibration, refitted, refitted_loop, session, without_frames

from skincal.dataset import HOLD
from skincal.diagnosis.workflow import refitted_effects
from skincal.errors import InputError


def test_refitted_effects_recover_the_truth():
    found = refitted_loop()
    (one,) = found.effects
    assert one.name == "hysteresis"
    for name, true in LOOP["hysteresis"].items():
        low, high = one.intervals[name]
        assert one.parameters[name] == pytest.approx(true, rel=0.1)
        assert float(low) < float(high) and abs(float(one.parameters[name]) - true) < 2 * (
            float(high) - float(low)
        )
    assert found.model.elasticity_pa_per_m == pytest.approx(calibration().model.elasticity_pa_per_m, rel=0.1)
    assert found.provenance == calibration().provenance
    # The loss is that of the fit with the effects.
    assert found.slack is not None and found.loss.presses_used == found.slack["used"].sum() > 0
    assert found.loss.mse_counts2 == pytest.approx(
        np.mean(found.slack["residual_rms_counts"][found.slack["used"]] ** 2), rel=1e-6
    )
    assert found.loss.mse_counts2 < 0.2


def test_effects_without_covariates_are_kept():
    data = without_frames(session(None))
    start = {"gain_drift": {"rate_per_s": -1e-3}, "crosstalk": {"leak": 0.02}}
    found = {e.name: e for e in refitted_effects(data, calibration(), calibration(start)).effects}
    assert set(found) == {"gain_drift", "crosstalk"}
    assert found["gain_drift"].parameters["rate_per_s"] == -1e-3
    assert float(found["crosstalk"].parameters["leak"]) != 0.02


def test_effects_of_another_sensor_are_refused():
    other = calibration(LOOP)
    other = replace(other, sensor=replace(other.sensor, rows=other.sensor.rows + 1))
    with pytest.raises(InputError, match="5 x 4 taxels"):
        refitted_effects(session(LOOP), calibration(), other)


def test_outlier_press_is_left_out():
    data = session(LOOP)
    assert data.frames is not None
    frames = data.frames
    counts, own = frames.counts.copy(), frames.press == 105
    counts[own] = np.clip(counts[own][:, ::-1] + 60.0, 0, 255)
    images = data.presses.counts.copy()
    images[data.presses.press == 105] = counts[own & (frames.phase == HOLD)].mean(axis=0)
    corrupted = replace(
        data, frames=replace(frames, counts=counts), presses=replace(data.presses, counts=images)
    )
    clean, found = refitted_loop(), refitted(corrupted)
    assert found.slack is not None
    assert found.slack["press"][~found.slack["used"]].tolist() == [105]
    for name, value in clean.effects[0].parameters.items():
        low, high = clean.effects[0].intervals[name]
        assert abs(float(found.effects[0].parameters[name]) - float(value)) < float(high) - float(low)
