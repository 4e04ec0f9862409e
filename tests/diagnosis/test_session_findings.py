"""Findings of a diagnosis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inference.made import made
from report.diagnosis_cases import calibration

from skincal.calibration import Finding
from skincal.dataset import Dataset
from skincal.diagnosis.observed import Observed, observe
from skincal.diagnosis.residual_location import residual_shares
from skincal.diagnosis.session_findings import _moving_rest, far_readings
from skincal.inference.start import fit_base


def observed(data: Dataset) -> Observed:
    return observe(data, replace(calibration(), sensor=data.meta.sensor), np.random.default_rng(0))


def findings_of(data: Dataset) -> list[Finding]:
    session = observed(data)
    return list(far_readings(session, fit_base(session.fitter, start_is_calibrated=True)))


def test_outlier_at_one_taxel_is_reported():
    """The image as a whole is no outlier, since most taxels are right; one press has no force."""
    data = made(rest=40.0)
    assert data.frames is not None
    force, of_frames = data.presses.force_n.copy(), data.frames.force_n.copy()
    force[3], of_frames[data.frames.press == data.presses.press[3]] = np.nan, np.nan
    frames = replace(data.frames, force_n=of_frames)
    data = replace(data, presses=replace(data.presses, force_n=force), frames=frames)
    # A lit taxel far from the contact, which no other contact position would explain.
    lit_taxels = np.where(observed(data).is_test, 0, (data.presses.counts > 45.0).sum(axis=1))
    row = int(lit_taxels.argmax())
    own = data.presses.counts[row].reshape(4, 4)
    number, lit = data.presses.press[row], 15 - int(own.argmax())
    counts = frames.counts.copy()
    counts[frames.press == number, lit] = own.max()
    assert not findings_of(data)
    (one,) = findings_of(replace(data, frames=replace(frames, counts=counts)))
    assert one.code == "far_readings"
    assert one.text.startswith(f"press {number}: taxel_{lit // 4}_{lit % 4} is ")


def test_parts_of_the_presses_are_compared_with_all_presses():
    """An excess that all presses have alike, and rest has not, lies in no part of them more than in another."""
    session = observed(made(rest=40.0)).session
    pressed = session.press >= 0
    assert not pressed.all()
    shares = {one.name: one for one in residual_shares(np.where(pressed, 2.0, 1.0)[:, None], session)}
    assert shares["force"].times == pytest.approx(1.0) == shares["small force"].times
    assert shares["force"].share + shares["small force"].share == pytest.approx(1.0)


def test_rest_that_moves_is_passed_on():
    fitted = calibration()
    assert not [*_moving_rest(fitted)]
    (told,) = _moving_rest(replace(fitted, findings=(Finding("rest_moves", "info", "", ""),)))
    assert told.code == "rest_moves" and "re-zeroing" in told.text
