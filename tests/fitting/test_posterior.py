from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from skincal.fitting.alternatives import LawSpread, weigh_laws
from skincal.fitting.conclude import add_unseen_errors
from skincal.fitting.observe import Readout
from skincal.fitting.outliers import (
    find_dead_taxels,
    find_dropped_readings,
    find_outlier_presses,
    find_weak_taxels,
)
from skincal.fitting.posterior import Bounds, Peak, climb, scaled_inverse
from skincal.fitting.presses import from_patch, to_patch
from skincal.fitting.problem import FitError, FitProblem, PressTable, Rig, build_problem
from skincal.fitting.sampling import Draws, sample
from skincal.fitting.tasks import Neighbourhood
from skincal.model import Plane, Sphere, TaxelLayout
from tests.fitting.conftest import Truth, make_session, rig

REST = (0.002, 0.01, 2e-5)
"""Relative misfit, spread of gains, smooth error of positions [m]."""

BOUNDS = Bounds(
    np.array([-3e-3, 0.02, -0.4, math.log(1e8), 0.0]), np.array([3e-3, 0.027, 0.4, math.log(2e9), 8.0])
)


def climbed(problem: FitProblem, start: np.ndarray, bounds: Bounds = BOUNDS) -> Peak:
    return climb(Neighbourhood.around(start).model(problem), bounds, start)


@pytest.fixture(scope="module")
def problem(truth: Truth) -> FitProblem:
    return build_problem(rig(), make_session(truth, presses=45, seed=4)[0])


@pytest.fixture(scope="module")
def peak(problem: FitProblem, truth: Truth) -> Peak:
    """The peak of the posterior, from the truth."""
    return climbed(problem, truth.macro)


def test_what_nothing_determines_may_vary_without_bound() -> None:
    """Without a warning of an overflow."""
    inverse = scaled_inverse(np.diag([1e-310, 2.0]))
    assert inverse[0, 0] > 1e299 and inverse[1, 1] == pytest.approx(0.5)


def test_patch_coordinates_and_back() -> None:
    rng = np.random.default_rng(0)
    offset, alpha = rng.normal(size=(20, 2)), rng.uniform(-3, 3, 20)
    uv = to_patch(offset[:, 0], offset[:, 1], alpha)
    assert from_patch(uv, alpha) == pytest.approx(offset)
    # Contract: across = u cos a - v sin a, along = u sin a + v cos a.
    assert from_patch(np.array([[1.0, 0.0]]), np.array([math.pi / 2])) == pytest.approx(
        np.array([[0.0, 1.0]])
    )


def test_slopes_of_a_press_agree_with_finite_differences(problem: FitProblem, truth: Truth) -> None:
    macro, n = truth.macro, len(problem)
    model = Neighbourhood.around(macro).model(problem)
    press, sigmas = np.arange(n), np.broadcast_to([1e-3, 0.01, 1.0, *REST], (n, 6))
    many, nuisance = np.broadcast_to(macro, (n, 5)), np.full((n, 3), [1e-4, -2e-4, 0.01])
    at = model.evaluate(many, sigmas, press, nuisance)
    for d, h in enumerate((2e-6, 2e-6, 5e-4, 1e-3, 1e-4)):
        step = np.eye(5)[d] * h
        ahead = model.evaluate(many + step, sigmas, press, nuisance).residual
        behind = model.evaluate(many - step, sigmas, press, nuisance).residual
        slope = (ahead - behind) / (2 * h)
        assert np.abs(slope - at.macro_slope[:, :, d]).max() < 0.03 * np.abs(slope).max(), d
    for d, h in enumerate((2e-6, 2e-6, 1e-3)):
        step = np.eye(3)[d] * h
        ahead = model.evaluate(many, sigmas, press, nuisance + step).residual
        behind = model.evaluate(many, sigmas, press, nuisance - step).residual
        slope = (ahead - behind) / (2 * h)
        assert np.abs(slope - at.nuisance_slope[:, :, d]).max() < 0.03 * np.abs(slope).max(), d


def test_settling_never_makes_the_objective_worse(problem: FitProblem, truth: Truth) -> None:
    macro, n = truth.macro, len(problem)
    model = Neighbourhood.around(macro).model(problem)
    press, sigmas = np.arange(n), np.broadcast_to([1e-3, 0.01, 0.3, *REST], (n, 6)).copy()
    start, many = np.zeros((n, 3)), np.broadcast_to(macro, (n, 5)).copy()
    before = model.evaluate(many, sigmas, press, start).objective
    after = model.fit_nuisance(many, sigmas, press, start, iterations=10)
    assert (after.objective <= before + 1e-9).all()
    assert np.abs(after.nuisance[:, :2]).max() <= 2e-3


def test_a_climb_from_afar_comes_back_to_the_truth(problem: FitProblem, truth: Truth) -> None:
    start = truth.macro + np.array([0.4e-3, -0.4e-3, 0.06, 0.3, 0.05])
    peak = climbed(problem, start)
    error = np.abs(peak.macro - truth.macro) / np.sqrt(np.diag(peak.covariance))
    assert (error < 4.0).all()
    assert peak.sigmas[0] == pytest.approx(0.5e-3, rel=0.35)
    assert np.isfinite(peak.log_evidence)


def test_gains_are_free_with_a_common_scale(problem: FitProblem, peak: Peak) -> None:
    dead = problem.without_taxels(np.arange(16) == 3)
    way = dead.shared.directions(dead.alive)
    assert way.shape == (len(dead.shared.theta), len(dead.shared.theta) - 2)
    assert way.T @ way == pytest.approx(np.eye(way.shape[1]), abs=1e-12)
    assert np.abs(way[:16].sum(axis=0)).max() < 1e-12 and np.abs(way[3]).max() == 0.0
    assert peak.theta[:16].mean() == pytest.approx(0.0, abs=1e-12)


def test_draws_have_what_presses_leave_open_whatever_they_are(problem: FitProblem, peak: Peak) -> None:
    """The mean gain of 16 taxels, and a pose that is another at other forces."""
    rng = np.random.default_rng(0)
    theta = np.zeros_like(peak.theta)
    by_force = int(np.argmax(problem.shared.fading))
    theta[32 + by_force] = 1e-4  # across
    bent = problem.with_shared(theta)
    same = np.tile(np.concatenate([peak.macro, np.log(peak.sigmas)]), (4000, 1))
    told = add_unseen_errors(bent, same, rng) - same
    assert told[:, 4].std() == pytest.approx(peak.sigmas[4] / 4, rel=0.05)
    half = 1e-4 * problem.shared.fading[by_force]
    others = 1e-4 * math.sqrt(2 / len(problem))
    assert half > 1e-4
    assert told[:, 0].mean() == pytest.approx(half / 2, abs=1e-5)
    assert told[:, 0].std() == pytest.approx(math.hypot(half / math.sqrt(12), others), rel=0.05)
    assert np.abs(told[:, 1:4]).max() == 0.0


def test_unbounded_gain_scatter_leaves_a_finite_scale(problem: FitProblem, peak: Peak) -> None:
    """Overflown words: no gains explain them, however different."""
    wild = np.concatenate([peak.macro, np.log(peak.sigmas)])
    wild[9] = np.log(40.0)
    told = add_unseen_errors(problem, np.tile(wild, (1000, 1)), np.random.default_rng(0))
    low, high = np.log(problem.scales)
    assert ((told[:, 4] >= low) & (told[:, 4] <= high)).all()
    assert low < peak.macro[4] - 5 and high > peak.macro[4] + 5


def test_presses_at_one_place_unlike_the_model_have_a_density() -> None:
    """Ten like presses on five large taxels, images of another law: no noise, and the box bounds what is not told."""
    cross = 6e-3 * np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, 0.0], [1.0, 0.0], [0.0, -1.0]])
    layout = TaxelLayout(1, 5, cross, np.full((5, 2), 4e-3))
    readout = Readout(None, None, False, rest_subtracted=True)
    flat = Rig(layout, Plane(), (Sphere(0.005),), readout, 0.5e-3, 1e-3)
    images = np.array([1800.0, 3970.0, 3330.0, 2120.0, 620.0]) + np.outer(
        np.linspace(-9.0, 9.0, 10), np.ones(5)
    )
    table = PressTable(
        np.arange(10),
        np.zeros(10),
        np.zeros(10),
        np.linspace(33.5, 31.3, 10),
        images,
        np.zeros(10, dtype=np.intp),
    )
    bounds = Bounds(np.array([-5e-3, -5e-3, -1.5, 18.4, 0.0]), np.array([5e-3, 5e-3, 1.5, 21.4, 11.0]))
    problem = build_problem(flat, table)
    start = np.array([2.5e-3, -2.5e-3, -0.15, 19.0, 7.0])
    peak = climbed(problem, start, bounds)
    assert np.isfinite(peak.log_density)
    assert (np.sqrt(np.diag(peak.covariance)) < bounds.high - bounds.low).all()


def test_a_press_that_lies_is_called_a_glitch_and_no_other(truth: Truth) -> None:
    presses, _ = make_session(truth, presses=45, seed=5)
    counts = presses.counts.copy()
    honest = build_problem(rig(), presses)
    row = int(honest.rows[3])
    counts[row] = counts[row][::-1] * 0.5 + 20.0
    spoilt = build_problem(rig(), replace(presses, counts=counts))
    peak = climbed(spoilt, truth.macro)
    assert list(spoilt.rows[find_outlier_presses(spoilt, peak)]) == [row]
    clean = climbed(honest, truth.macro)
    assert not find_outlier_presses(honest, clean).any()


def test_dropped_reading_is_left_out_without_its_press(truth: Truth) -> None:
    presses, _ = make_session(truth, presses=45, seed=4)
    unclipped = replace(rig(), readout=Readout(None, None, False))
    counts = presses.counts + 20.0
    honest = build_problem(unclipped, replace(presses, counts=counts.copy()))
    dark = int(honest.rows[0]), int(np.argmin(honest.values[0]))
    counts[dark] = 0.0
    spoilt = build_problem(unclipped, replace(presses, counts=counts))
    peak = climbed(spoilt, truth.macro)
    lost = find_dropped_readings(spoilt, peak.states, 0.05)
    assert [tuple(at) for at in np.argwhere(lost)] == [(0, dark[1])]
    left = spoilt.without_readings(lost)
    assert left.used.sum() == spoilt.used.sum() - 1 and left.alive.all()
    clean = climbed(honest, truth.macro)
    assert not find_dropped_readings(honest, clean.states, 0.0).any()


def test_a_reading_of_a_weak_taxel_is_not_lost(truth: Truth) -> None:
    problem = build_problem(rig(), make_session(truth, presses=45, seed=4)[0])
    states = climbed(problem, truth.macro).states
    # A tenth less than the model says, where the noise is a hundredth.
    loud = np.unravel_index(np.argmax(states.macro_slope[..., 4]), problem.values.shape)
    residual, slope = 0.1 * states.residual, 100 * states.macro_slope
    residual[loud] = 10.0
    slope[loud][4] = 100.0
    weak = states._replace(residual=residual, macro_slope=slope)
    assert [tuple(at) for at in np.argwhere(find_dropped_readings(problem, weak, 0.0))] == [loud]
    assert not find_dropped_readings(problem, weak, 0.05).any()


def test_a_taxel_that_stays_silent_is_found(truth: Truth) -> None:
    presses, _ = make_session(truth, presses=60, seed=6)
    counts = presses.counts.copy()
    counts[:, 5] = 0.4
    spoilt = build_problem(rig(), replace(presses, counts=counts))
    weak = find_weak_taxels(spoilt)
    assert list(np.flatnonzero(weak)) == [5]
    others = spoilt.without_taxels(weak)
    peak = climbed(others, truth.macro)
    assert list(np.flatnonzero(find_dead_taxels(spoilt, peak.states))) == [5]
    assert (spoilt.without_taxels(np.arange(16) == 5).weight[:, 5] == 0).all()


def test_importance_sampling_finds_a_known_density(problem: FitProblem, peak: Peak) -> None:
    """A correlated Gaussian of other width and centre than the first proposal."""
    rng = np.random.default_rng(0)
    sd = np.concatenate([np.sqrt(np.diag(peak.covariance)), [0.1, 0.5, 0.1, 0.5, 0.5, 0.5]])
    mean = np.concatenate([peak.macro, np.log(peak.sigmas)]) + 0.8 * sd
    mixing = np.eye(11)
    mixing[3, 4] = mixing[0, 2] = 0.8
    root = sd[:, None] * mixing * 0.7

    def density(points: np.ndarray) -> np.ndarray:
        return -0.5 * (np.linalg.solve(root, (points - mean).T) ** 2).sum(axis=0)

    draws, _ = sample(peak, problem, density, rng, size=400, rounds=(8, 8), enough_draws=400)
    assert draws.effective > 500
    found = draws.weight @ draws.points
    assert np.abs((found - mean) / sd).max() < 0.15
    spread = np.sqrt(draws.weight @ (draws.points - found) ** 2)
    assert spread / np.sqrt(np.diag(root @ root.T)) == pytest.approx(np.ones(11), abs=0.12)
    again = draws.resampled(rng, 4000)
    assert np.abs((again.mean(axis=0) - mean) / sd).max() < 0.2

    # A term by which the density rises moves all draws by its slope, and by no more.
    def rising(at: np.ndarray) -> np.ndarray:
        return 0.5 * (at[:, 3] - mean[3]) / np.linalg.norm(root[3])

    moved, _ = sample(
        peak,
        problem,
        density,
        rng,
        size=400,
        rounds=(8, 8),
        enough_draws=400,
        expensive_term=rising,
        term_points=60,
    )
    assert moved.effective > 500
    assert (moved.mean - mean)[3] / np.linalg.norm(root[3]) == pytest.approx(0.5, abs=0.12)


def test_equal_weights_are_worth_their_number() -> None:
    assert Draws(np.zeros((50, 11)), np.full(50, 0.02)).effective == pytest.approx(50)


def test_contact_law_widens_elasticity_and_scale_only(problem: FitProblem, truth: Truth, peak: Peak) -> None:
    start, wider = truth.macro, (0.2e-3, 0.4e-3)
    tabled = [replace(Neighbourhood.around(start), spread_m=s).model(problem) for s in wider]
    peaks = [peak, *(climb(model, BOUNDS, start) for model in tabled)]
    law = weigh_laws(np.array([0.0, 0.2e-3, 0.4e-3]), peaks)
    assert law.density.sum() == pytest.approx(1.0)
    assert (law.shift[:, :3] == 0).all()
    assert law.shift[-1, 3] > 0.05
    draws = np.zeros((2000, 5))
    wide = law.shifted(draws, np.random.default_rng(0))
    assert wide[:, 3].max() > 0 and (wide[:, :3] == 0).all()
    # These data come from the foundation itself: a wide spread is the worse law.
    assert law.density[0] > 3 * law.density[-1]
    assert (
        LawSpread(np.zeros(1), np.ones(1), np.zeros((1, 5))).shifted(draws, np.random.default_rng(0)) == draws
    ).all()


def test_bare_pressure_widens_e_and_s(peak: Peak) -> None:
    moved = replace(peak, macro=peak.macro + np.array([1e-4, 1e-4, 0.1, 0.03, -0.02]))
    law = weigh_laws(np.zeros(1), [peak]).with_unprojected(peak, moved)
    wide = law.shifted(np.zeros((2000, 5)), np.random.default_rng(0))
    assert law.unprojected == pytest.approx(0.5)
    assert np.unique(wide, axis=0) == pytest.approx(np.array([[0, 0, 0, 0, 0], [0, 0, 0, 0.03, -0.02]]))
    ruled_out = weigh_laws(np.zeros(1), [peak]).with_unprojected(
        peak, replace(moved, log_density=peak.log_density - 50)
    )
    assert ruled_out.unprojected < 1e-6


def test_a_law_without_density_is_ruled_out(peak: Peak) -> None:
    nowhere = replace(peak, log_density=-math.inf)
    law = weigh_laws(np.array([0.0, 0.2e-3, 0.4e-3]), [peak, peak, nowhere])
    assert law.widths_m[-1] == 0.2e-3 and np.isfinite(law.shift).all()
    with pytest.raises(FitError, match="no pose, elasticity and scale"):
        weigh_laws(np.array([0.0, 0.2e-3]), [nowhere, peak])


def test_a_density_that_is_nowhere_finite_fails_the_fit(problem: FitProblem, peak: Peak) -> None:
    def nowhere(points: np.ndarray) -> np.ndarray:
        return np.full(len(points), np.nan)

    with pytest.raises(FitError, match="do not belong together"):
        sample(peak, problem, nowhere, np.random.default_rng(0), size=20, rounds=(1, 1), enough_draws=1)
