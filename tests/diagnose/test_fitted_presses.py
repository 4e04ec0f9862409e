"""The loss and the slack of a calibration that a refit comes to are those of its own presses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.diagnose_data import moving, still
from report.diagnosis_cases import calibration

from skincal.calibration import SLACK_COLUMNS, Finding, write_calibration
from skincal.dataset import Dataset
from skincal.diagnose.base import calibrated_model
from skincal.diagnose.fitted_presses import GLITCH, UNKNOWN, hold_residuals, with_fitted_presses
from skincal.diagnose.session import gap_session
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.reading import Reading
from skincal.gap.session import GapSession

NONE = np.zeros(0, dtype=np.int64)


def case(data: Dataset, over: float = 0.0) -> tuple[Hypothesis, GapSession, Reading]:
    """Presses that lie half a millimetre from where they were measured and read so much more than is expected."""
    session = gap_session(data)
    model = calibrated_model(calibration(), data)
    found = Hypothesis(model, np.tile([0.5e-3, -0.3e-3, 0.0], (len(data.presses), 1)))
    bare = Reading.of(session, 1.0, model.readout)
    counts = np.where(np.isfinite(bare.counts), bare.expected(found.values(session)) + over, np.nan)
    return found, session, replace(bare, counts=counts)


@pytest.mark.parametrize("data", [moving(), still()], ids=["frames", "holds"])
def test_the_loss_is_the_mean_square_of_what_is_left_of_the_holds(data: Dataset):
    found, session, reading = case(data, over=2.0)
    left, noise = hold_residuals(found, session, reading, len(data.presses))
    assert (np.isfinite(left) == np.isfinite(noise)).all() and np.nanmin(noise) > 0
    np.testing.assert_allclose(left[np.isfinite(left)], 2.0)
    old = calibration()
    new = with_fitted_presses(old, found, session, reading, data, NONE)
    assert new.loss.mse_counts2 == pytest.approx(4.0)
    above = old.loss.valley_mse_counts2 - old.loss.mse_counts2
    assert new.loss.valley_mse_counts2 == pytest.approx(4.0 + above)
    assert new.loss.presses_used == len(data.presses)


def test_slack_tells_where_each_press_was_and_which_was_not_used(tmp_path):
    data = moving()
    found, session, reading = case(data)
    counts = reading.counts.copy()
    counts[session.press == 5] = np.nan
    trust = np.where((session.press == 5)[:, None], 0.0, reading.trust)
    new = with_fitted_presses(
        calibration(), found, session, replace(reading, counts=counts, trust=trust), data, np.array([3])
    )
    table = new.slack
    assert table is not None and set(SLACK_COLUMNS) <= set(table)
    assert table["reason"].tolist() == [
        {3: GLITCH, 5: UNKNOWN}.get(row, "") for row in range(len(data.presses))
    ]
    assert new.loss.presses_used == len(data.presses) - 2 == table["used"].sum()
    used = np.flatnonzero(table["used"])
    np.testing.assert_allclose(table["slack_across_m"][used], 0.5e-3)
    points = np.stack([table[name] for name in ("x_m", "y_m", "z_m")], axis=1)
    assert np.isnan(points[[3, 5]]).all() and np.isnan(table["slack_along_m"][[3, 5]]).all()
    # The same places as those that the model pressed.
    placed = found.placed(session).samples.contacts.points_m
    for row in used:
        own = placed[(session.row == row) & np.isfinite(placed).all(axis=1)]
        assert np.linalg.norm(own - points[row], axis=1).min() < 2e-5
    write_calibration(new, tmp_path / "new")


def test_what_a_fit_found_of_its_images_is_not_said_of_others():
    data = moving()
    found, session, reading = case(data)
    said = [Finding(code, "warning", code, "") for code in ("misfit", "range_edge", "force_scatter")]
    old = replace(calibration(), findings=tuple(said))
    new = with_fitted_presses(old, found, session, reading, data, NONE)
    assert [one.code for one in new.findings] == ["range_edge"]
    more = with_fitted_presses(old, found, session, reading, data, unexplained=True)
    assert [one.code for one in more.findings] == ["range_edge", "misfit"]
    assert "Beside the effects" in more.findings[1].text
    said = replace(old, findings=(Finding("slack_too_tight", "warning", "far", ""),))
    assert with_fitted_presses(said, found, session, reading, data, NONE).findings == said.findings
    moves = found.with_effects({"contact_offset": {"stretch_across": np.asarray(0.01)}})
    assert not with_fitted_presses(said, moves, session, reading, data, NONE).findings


def test_noise_and_forces_are_those_of_the_refit_where_a_fit_told_them():
    data = moving()
    found, session, reading = case(data, over=2.0)
    places = found.places.copy()
    places[:, 2] = 0.03
    found = found.with_places(places)
    counts = np.where(np.isfinite(reading.counts), reading.expected(found.values(session)) + 2.0, np.nan)
    extra = {"noise_sigma_counts": 9.0, "force_sigma_relative": 0.2, "position_sigma_m": 5e-4}
    old = calibration()
    told = replace(old, loss=replace(old.loss, extra=extra))
    new = with_fitted_presses(told, found, session, replace(reading, counts=counts), data, NONE)
    assert new.loss.extra["force_sigma_relative"] == pytest.approx(0.03)
    # Two of sixteen values of a press are its place's.
    assert new.loss.extra["noise_sigma_counts"] == pytest.approx(2.0 * np.sqrt(16 / 14), rel=0.02)
    assert new.loss.extra["position_sigma_m"] == 5e-4 and set(new.loss.extra) == set(extra)


def test_a_bound_that_was_fixed_stays():
    data = moving()
    found, session, reading = case(data, over=1.0)
    old = calibration()
    fixed = replace(old, loss=replace(old.loss, valley_mse_counts2=25.0, extra={"valley_bound": "fixed"}))
    assert with_fitted_presses(fixed, found, session, reading, data, NONE).loss.valley_mse_counts2 == 25.0


def test_a_press_that_fits_far_worse_than_others_is_no_good_one():
    data = moving()
    found, session, reading = case(data, over=0.2)
    counts = reading.counts + np.where(session.press == 7, 5.0, 0.0)[:, None]
    new = with_fitted_presses(calibration(), found, session, replace(reading, counts=counts), data, NONE)
    assert new.slack is not None
    assert np.flatnonzero(~new.slack["good"]).tolist() == [7]
