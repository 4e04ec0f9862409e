"""Pressure chambers: preparation for the inference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chambers import Chamber

from skincal.calibrate import calibrate_uniform
from skincal.dataset import read_dataset
from skincal.diagnosis.observed import Observed, frame_forward, observe
from skincal.diagnosis.taxel_faults import find_faults
from skincal.diagnosis.updated_calibration import updated_parameters


def observed(folder: Path, chamber: Chamber, *, frames: bool = True) -> Observed:
    data = read_dataset(chamber.write(folder / "chamber", frames=frames))
    return observe(data, calibrate_uniform(data).calibration, np.random.default_rng(0))


def test_frames_have_the_margin_of_the_fitted_skin(tmp_path: Path):
    """A narrower modelled skin would bear the force on a smaller area."""
    one = observed(tmp_path, Chamber.plain())
    state, forward, whole = one.fitter.priors.start, one.fitter.forward, frame_forward(one)
    fitted, frames = (f.mean @ f.predict(state).values for f in (forward, whole))
    for press in (3, 11, 20):
        rows = [f.session.held() & (f.session.press == press) for f in (forward, whole)]
        assert frames[rows[1]].mean(axis=0) == pytest.approx(fitted[rows[0]].mean(axis=0), rel=0.01)


def test_dead_taxel_has_an_initial_state_and_stays_dead(tmp_path: Path):
    chamber = Chamber.plain()
    chamber.gain[3] = 0.0
    data = read_dataset(chamber.write(tmp_path / "chamber"))
    cal = calibrate_uniform(data).calibration
    assert cal.model.scale_per_taxel_per_n is not None and cal.model.scale_per_taxel_per_n[3] == 0.0
    start = observe(data, cal, np.random.default_rng(0)).fitter.priors.start
    assert np.isfinite(start.log_s).all()
    new = updated_parameters(cal, start)
    assert new.scale_per_taxel_per_n == pytest.approx(cal.model.scale_per_taxel_per_n)
    assert new.scale_per_n == pytest.approx(cal.model.scale_per_n)


def test_noise_and_rest_level_without_frames(tmp_path: Path):
    chamber = Chamber.plain(plateaus=16)
    chamber.rest[:] = np.linspace(10.0, 20.0, 16)
    one = observed(tmp_path, chamber, frames=False)
    assert one.floor.mean_counts == pytest.approx(0.33, rel=0.35)
    before = one.fitter.priors
    assert before.start.rest == pytest.approx(15.0, abs=1.0)
    assert 1 / np.sqrt(before.base[5]) == pytest.approx(3.5, abs=1.0)


@pytest.mark.parametrize("taxels", [4, 16])
def test_disconnected_board_is_left_out(tmp_path: Path, taxels: int):
    """Some or all taxels read full scale for a while."""
    data = read_dataset(Chamber.plain().write(tmp_path / "chamber"))
    truth = calibrate_uniform(data).calibration
    presses, frames = data.presses, data.frames
    assert frames is not None
    ids = presses.press[4:20]
    counts, means = frames.counts.copy(), presses.counts.copy()
    counts[np.isin(frames.press, ids), :taxels], means[4:20, :taxels] = 255.0, 255.0
    # The calibration took full scale for a reading.
    scale = np.array(truth.model.scale_per_taxel_per_n)
    scale[:taxels] *= 3.0
    wrong = replace(truth, model=replace(truth.model, scale_per_taxel_per_n=tuple(scale)))
    data = replace(data, presses=replace(presses, counts=means), frames=replace(frames, counts=counts))
    one = observe(data, wrong, np.random.default_rng(0))
    stuck = find_faults(one.session, one.fitter, one.fitter.priors.start, state_is_calibrated=True)
    assert sorted(s.taxel for s in stuck) == list(range(taxels)) and all(s.counts > 250 for s in stuck)
    left = one.without(stuck)
    assert left.session.counts is not None and not (left.session.counts > 250).any()
    assert np.isfinite(left.fitter.priors.start.log_s).all()
