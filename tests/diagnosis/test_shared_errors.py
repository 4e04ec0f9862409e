"""Intervals after a diagnosis hold the errors that presses share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from report.diagnosis_cases import LOOP, calibration, session

from skincal.calibration import Calibration
from skincal.dataset import Dataset, ForceSpec
from skincal.diagnosis.workflow import refitted_effects

START = {"hysteresis": {"height": 0.25, "width": 0.8}}
ANGLE, STIFFNESS = "alpha_deg", "elasticity_pa_per_m"


def refitted(data: Dataset) -> Calibration:
    return refitted_effects(data, calibration(), calibration(START))


def width(found: Calibration, name: str) -> float:
    low, high = found.intervals[name]
    return high - low


@pytest.fixture(scope="module")
def plain() -> Calibration:
    return refitted(session(LOOP))


def test_smooth_errors_of_positions_widen_the_angle(plain: Calibration):
    data = session(LOOP)
    assert data.frames is not None
    middle = float(data.presses.position_m[:, 1].mean())

    def bent(places: np.ndarray) -> np.ndarray:
        along = np.nan_to_num(places[:, 1] - middle)
        return data.surface().offset(places, 0.1 * along, -0.06 * along)

    presses = replace(data.presses, position_m=bent(data.presses.position_m))
    frames = replace(data.frames, position_m=bent(data.frames.position_m))
    found = refitted(replace(data, presses=presses, frames=frames))
    assert width(found, ANGLE) > 1.5 * width(plain, ANGLE)
    low, high = found.intervals[ANGLE]
    assert low <= calibration().model.alpha_deg <= high


def test_a_scale_of_forces_that_is_not_known_widens_the_stiffness(plain: Calibration):
    data = session(LOOP)
    found = refitted(replace(data, meta=replace(data.meta, force=ForceSpec(scale_sigma=0.1))))
    best = found.model.elasticity_pa_per_m
    assert width(found, STIFFNESS) > 0.4 * best > width(plain, STIFFNESS)
