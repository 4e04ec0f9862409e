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


def off(data: Dataset, error_m: np.ndarray) -> Dataset:
    """The session with positions of presses (P, 2) off by so much, across and along."""
    presses, frames = data.presses, data.frames
    assert frames is not None
    row = np.searchsorted(presses.press, np.maximum(frames.press, presses.press[0]))
    moved = data.surface().offset(presses.position_m, *error_m.T)
    of_frames = data.surface().offset(frames.position_m, *error_m[row].T)
    return replace(
        data, presses=replace(presses, position_m=moved), frames=replace(frames, position_m=of_frames)
    )


def test_smooth_errors_of_positions_widen_the_angle():
    data = session(LOOP)
    along = data.presses.position_m[:, 1] - data.presses.position_m[:, 1].mean()
    smooth = np.outer(along, [0.1, -0.06])
    chance = np.random.default_rng(1).permutation(smooth)
    found = refitted(off(data, smooth))
    assert width(found, ANGLE) > 1.15 * width(refitted(off(data, chance)), ANGLE)
    low, high = found.intervals[ANGLE]
    assert low <= calibration().model.alpha_deg <= high


def test_a_scale_of_forces_that_is_not_known_widens_the_stiffness(plain: Calibration):
    data = session(LOOP)
    found = refitted(replace(data, meta=replace(data.meta, force=ForceSpec(scale_sigma=0.1))))
    best = found.model.elasticity_pa_per_m
    assert width(found, STIFFNESS) > 0.4 * best > width(plain, STIFFNESS)
