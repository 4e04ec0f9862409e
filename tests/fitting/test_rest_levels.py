"""Fits of sensors whose level at rest is not clipped: any level, any noise, any unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.fitting.observe import Readout
from skincal.fitting.problem import PressTable, build_problem
from skincal.fitting.readings import Link
from skincal.fitting.result import PARAMETERS, FitResult
from skincal.fitting.shared import smooth_field
from skincal.fitting.solve import solve
from tests.fitting.conftest import BOX, ONE_LAW, Truth, make_session, rig, some_presses

FLOAT = Readout(None, None, False)
SUBTRACTED = Readout(None, None, False, rest_subtracted=True)


def values_of(seed: int, presses: int = 30) -> PressTable:
    """Presses with the exact values of the skin above rest, and positions off by half a millimetre."""
    return make_session(presses=presses, seed=seed, noise=0.0)[0]


def fit(table: PressTable, readout: Readout) -> FitResult:
    problem = build_problem(rig(readout), table)
    return solve(problem, BOX, ONE_LAW, np.random.default_rng(0))


def check(result: FitResult, scale: float = 1.0) -> None:
    """All intervals are there, narrow, and hold the truth."""
    truth = Truth()
    told = [getattr(truth, name) for name in PARAMETERS]
    told[-1] *= scale
    assert result.effective_draws >= 100
    assert not {"few_draws", "force_scatter", "misfit", "positions_bent"} & {f.code for f in result.findings}
    for name, value in zip(PARAMETERS, told, strict=True):
        low, high = result.intervals[name]
        slack = 0.02 * (high - low)
        assert low - slack <= value <= high + slack, name
    low, high = result.intervals["scale_per_n"]
    assert high / low < 1.25


def test_single_frames_that_rest_at_twenty_counts() -> None:
    table = values_of(1)
    rng = np.random.default_rng(2)
    counts = np.rint(table.counts + 20.0 + rng.standard_normal(table.counts.shape))
    result = fit(replace(table, counts=counts), Readout(0, 300, True))
    check(result)
    assert result.rest_interval[0] <= 20.0 <= result.rest_interval[1]
    assert result.sigmas.noise_counts == pytest.approx(1.04, rel=0.15)


def test_subtracted_readings_in_volts() -> None:
    table = values_of(3)
    rng = np.random.default_rng(4)
    counts = 1e-3 * (table.counts + rng.standard_normal(table.counts.shape))
    result = fit(replace(table, counts=counts), SUBTRACTED)
    check(result, 1e-3)
    assert result.rest_counts == 0.0


def test_a_simulator_without_noise() -> None:
    table = values_of(5)
    check(fit(replace(table, counts=table.counts + 600.0), FLOAT))


def test_a_busy_taxel_rests_elsewhere_than_the_others() -> None:
    table = values_of(6, 50)
    rng = np.random.default_rng(7)
    levels = 600.0 + 20.0 * rng.standard_normal(16)
    busy = int(np.argmax((table.counts > 5).sum(axis=0)))
    touched = table.counts[:, busy] > 5
    levels[busy] = 560.0
    table = replace(table, counts=table.counts + levels + rng.standard_normal(table.counts.shape))
    problem = build_problem(rig(FLOAT), some_presses(table, touched))
    assert not problem.observed.level_known[busy]
    assert problem.observed.level_known.sum() >= 12
    # How far the levels lie apart is all that is known of it, and that reaches to where it is.
    assert 15.0 < problem.shared.level_sigma[busy] < 120.0
    assert abs(problem.observation.offset[busy] - 560.0) < 2.5 * problem.shared.level_sigma[busy]


def test_a_link_has_the_mean_and_slope_of_clipped_noise() -> None:
    link = Link.of(Readout(0, 255, True), 1.0)
    values = np.array([0.0, 0.7, 30.0])
    rng = np.random.default_rng(0)
    frames = np.clip(np.rint(values + rng.standard_normal((200_000, 3))), 0, None)
    assert link.mean_at(values) == pytest.approx(frames.mean(axis=0), abs=0.01)
    assert np.interp(30.0, link.values, link.slope) == pytest.approx(1.0, abs=0.01)
    assert link.scatter(values) * np.hypot(1.0, 12**-0.5) == pytest.approx(frames.std(axis=0), rel=0.02)
    assert not Link.of(FLOAT, float("nan")).clips


def test_smooth_errors_have_no_part_that_a_pose_takes_up() -> None:
    rng = np.random.default_rng(0)
    places, force, rows = rng.uniform(-7e-3, 7e-3, (40, 2)), rng.uniform(1.0, 4.0, 40), np.arange(40)
    basis, fading = smooth_field(places, force, np.empty((40, 0)), rows)
    assert basis.shape == (40, 6)
    assert np.abs(basis.mean(axis=0)).max() < 1e-12
    assert basis.T @ basis / 40 == pytest.approx(np.eye(6), abs=1e-9)
    # An error of 0.1 mm/N is half as large at half of the force.
    error = 1e-4 * force
    found = np.linalg.lstsq(np.column_stack([np.ones(40), basis]), error, rcond=None)[0]
    assert found[1:] @ fading == pytest.approx(error.mean() / 2, rel=0.02)
    # Nearly equal forces show no such error, and must not allow any that is far larger at half of the force.
    nearly_equal, less = smooth_field(places, 2.0 + 0.1 * force, np.empty((40, 0)), rows)
    assert nearly_equal.shape == (40, 6)
    assert np.abs(less).max() < 2.5
    assert (
        np.abs(smooth_field(places, 2.0 + 1e-3 * force, np.empty((40, 0)), rows)[1]).max(initial=0.0) == 0.0
    )
    at_one_place = smooth_field(np.zeros((40, 2)), np.ones(40), np.empty((40, 0)), rows)[0]
    assert at_one_place.shape == (40, 0)


def test_smooth_error_of_places_and_postures() -> None:
    rng = np.random.default_rng(1)
    places, force = rng.uniform(-7e-3, 7e-3, (60, 2)), rng.uniform(1.0, 4.0, 60)
    bent = np.where(np.arange(60) % 2, 0.2, -0.2) + 0.01 * rng.standard_normal(60)
    # One joint follows the place, as joints do; the other tells which of two postures it was.
    joints = np.column_stack([places[:, 0] / 0.06, bent])
    fitted = np.flatnonzero(places[:, 0] > -3e-3)
    basis, _ = smooth_field(places, force, joints, fitted)
    assert basis.shape == (len(fitted), 7)
    error = 1e-3 * bent + 0.02 * places[:, 0]
    found = np.linalg.lstsq(np.column_stack([np.ones(len(fitted)), basis]), error[fitted], rcond=None)[0]
    everywhere = 1e-3 * bent + 0.02 * np.maximum(places[:, 0], places[fitted, 0].min())
    assert found[0] == pytest.approx(everywhere.mean(), abs=2e-6)
    assert abs(error[fitted].mean() - everywhere.mean()) > 1e-5
