from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from skincal.fitting.alternatives import LawSpread, Nonlinearity
from skincal.fitting.fit_findings import NONLINEAR_NATS, _check_rig, add_findings
from skincal.fitting.fit_options import GridSteps, SearchBox
from skincal.fitting.problem import FitError, FitProblem, build_problem
from skincal.fitting.result import OPEN, PARAMETERS, POSE, FitResult, at_one_place
from skincal.fitting.solve import plan_grid, solve
from skincal.model import FlatPunch, Plane
from tests.fitting.conftest import BOX, LAYOUT, ONE_LAW, QUICK, ROUGH, Truth, make_session, rig, some_presses


def _fit(
    problem: FitProblem, box: SearchBox = BOX, options: Any = QUICK, seed: int = 0, **more: Any
) -> FitResult:
    return solve(problem, box, options, np.random.default_rng(seed), **more)


@pytest.fixture(scope="module")
def fitted(truth: Truth) -> FitResult:
    return _fit(build_problem(rig(), make_session(truth, seed=11)[0]))


def _codes(result: FitResult) -> set[str]:
    return {finding.code for finding in result.findings}


def test_the_intervals_hold_the_truth_and_are_narrow(fitted: FitResult, truth: Truth) -> None:
    for name in PARAMETERS:
        low, high = fitted.intervals[name]
        assert low <= getattr(truth, name) <= high, name
        assert low <= fitted.best[name] <= high
    assert np.ptp(fitted.intervals["y_m"]) < 1.2e-3
    assert fitted.intervals["elasticity_pa_per_m"][1] / fitted.intervals["elasticity_pa_per_m"][0] < 1.6
    assert not _codes(fitted) & {"misfit", "range_edge", "not_identified", "few_draws"}


def test_the_loss_at_the_best_point_is_that_of_the_noise(fitted: FitResult) -> None:
    # 25 frames of one count, rounded: 0.2 counts where a taxel is lit, about half where it rests on its bound.
    assert 0.08**2 < fitted.mse_counts2 < 0.25**2
    assert fitted.mse_counts2 <= fitted.valley_mse_counts2 * 1.3
    assert fitted.presses.good.mean() > 0.9
    assert fitted.sigmas.position_m == pytest.approx(0.5e-3, rel=0.35)


def test_grid_loss_is_not_the_loss_that_noise_bounds(fitted: FitResult) -> None:
    grid = fitted.grid
    # Normalised images leave one direction of most presses to the rig's positions: counts, where noise is some tenths.
    assert grid.mse_counts2.min() > 10 * fitted.valley_mse_counts2
    assert grid.mse_at_best_counts2 > 10 * fitted.mse_counts2
    assert grid.mse_at_best_counts2 < np.quantile(grid.mse_counts2, 0.2)
    assert not grid.in_valley.any(), "no combination of the grid is in a valley of another loss"


def test_the_grid_and_the_draws_are_kept(fitted: FitResult) -> None:
    assert fitted.grid.mse_counts2.shape == fitted.grid.grid.shape
    assert fitted.draws.shape == (QUICK.draws, 5)
    assert np.isfinite(fitted.draws).all()


def test_a_seed_gives_one_result_for_any_workers_and_turns_kept(truth: Truth) -> None:
    """Interrupted after two turns of the grid and taken up again, with workers that end in another order."""
    options = replace(ROUGH, law_spreads_m=(0.0, 0.2e-3))
    problem = build_problem(rig(), make_session(truth, presses=25, seed=11)[0])
    kept: dict[int, Any] = {}
    order: list[int] = []
    evaluated: list[int] = []

    class InterruptError(Exception):
        pass

    class Interrupted:
        def keep(self, turn: int, slab: Any) -> None:
            kept[turn] = slab
            if len(kept) == 2:
                raise InterruptError

    class Watched:
        def keep(self, turn: int, _slab: Any) -> None:
            evaluated.append(turn)

    def backwards(function: Callable[[Any], Any], arguments: Sequence[Any]) -> list[Any]:
        results = [function(argument) for argument in reversed(arguments)]
        order.append(len(results))
        return results[::-1]

    def run(**more: Any) -> FitResult:
        return solve(problem, BOX, options, np.random.default_rng(0), **more)

    straight = run()
    with pytest.raises(InterruptError):
        run(store=Interrupted())
    again = run(slabs=kept, store=Watched(), mapper=backwards)
    assert order
    assert evaluated and not set(evaluated) & set(kept)
    assert again.best == straight.best
    assert again.intervals == straight.intervals
    assert (again.draws == straight.draws).all()


def test_the_papers_bound_gives_the_box_below_it(truth: Truth) -> None:
    problem = build_problem(rig(), make_session(truth, presses=30, seed=11)[0])
    result = _fit(problem, options=replace(ROUGH, bound_counts2=25.0))
    grid, inside = result.grid.grid, result.grid.mse_counts2 <= 25.0
    assert result.bound == "fixed" and result.valley_mse_counts2 == 25.0
    y = grid.y_m[inside.any(axis=(0, 1, 2))]
    low, high = result.intervals["y_m"]
    assert (low, high) == (-np.inf, np.inf) or (low <= y.min() and high >= y.max())
    assert result.intervals["scale_per_n"][0] == pytest.approx(
        min(result.grid.scale_per_n[inside].min(), result.best["scale_per_n"])
    )


def test_a_range_that_leaves_out_the_truth_is_said(truth: Truth) -> None:
    problem = build_problem(rig(), make_session(truth, presses=30, seed=12)[0])
    box = replace(BOX, y_m=(0.0242, 0.0262))
    result = _fit(problem, box, ONE_LAW)
    assert "range_edge" in _codes(result)
    told = next(f for f in result.findings if f.code == "range_edge")
    assert "lower end" in told.text and "Widen" in told.advice


def test_crosstalk_is_a_misfit(truth: Truth) -> None:
    """Taxels that leak into their neighbours look like a softer skin: the fit takes it up, and must say so."""
    table = make_session(truth, presses=30, seed=11)[0]
    apart = np.linalg.norm(LAYOUT.centres_m[:, None] - LAYOUT.centres_m, axis=-1)
    leak = 0.05 * ((apart > 0) & (apart < 1.1 * 0.004))
    result = _fit(build_problem(rig(), replace(table, counts=table.counts + table.counts @ leak)), BOX, ROUGH)
    told = next(f for f in result.findings if f.code == "misfit")
    assert told.severity == "warning" and "diagnose" in told.advice


def test_too_few_presses_at_one_place_give_no_interval(truth: Truth) -> None:
    presses, where = make_session(truth, presses=1500, seed=13, position_sigma_m=0.1e-3)
    # Between two taxels, so that both answer.
    between = np.array([truth.across_m, truth.y_m + 2e-3])
    near = np.abs(where - between).max(axis=1) < 0.7e-3
    problem = build_problem(rig(), some_presses(presses, near))
    assert len(problem) >= 6
    problem = problem.subset(np.arange(len(problem)) < 6, "left out")
    assert problem.unknowns == 17 and problem.readings <= 17
    result = _fit(problem, BOX, ROUGH)
    assert _codes(result) >= {"too_few_presses", "one_place"}
    assert not _codes(result) & {"few_presses", "not_identified", "range_edge"}
    assert set(result.intervals.values()) == {(-np.inf, np.inf)}
    told = next(f for f in result.findings if f.code == "too_few_presses")
    assert "for 17 unknowns" in told.text and "Do not use this calibration." in told.advice


def test_presses_at_one_place_tell_no_pose(fitted: FitResult) -> None:
    problem = fitted.problem
    close = replace(problem, across_m=0.1 * problem.across_m, along_m=0.1 * problem.along_m)
    assert at_one_place(close) and not at_one_place(problem)
    open_pose = {**fitted.intervals, **dict.fromkeys(POSE, OPEN)}
    found = add_findings(replace(fitted, problem=close, intervals=open_pose), dropped=0)
    told = [f for f in found.findings if f.code in ("one_place", "not_identified", "range_edge")]
    assert [f.code for f in told] == ["one_place"], "it is said once"
    assert "have no interval" in told[0].text and "Spread the presses" in told[0].advice


def test_a_flat_punch_shows_no_elasticity(fitted: FitResult) -> None:
    rig = replace(fitted.problem.rig, surface=Plane(), indenters=(FlatPunch(0.004),))
    open_e = {**fitted.intervals, "elasticity_pa_per_m": OPEN}
    for problem, advice in (
        (fitted.problem, "Widen"),
        (replace(fitted.problem, rig=rig), "Press with a sphere"),
    ):
        found = add_findings(replace(fitted, problem=problem, intervals=open_e), dropped=0)
        (told,) = (f for f in found.findings if f.code == "not_identified")
        assert advice in told.advice


def test_misfit_that_the_noise_of_weak_signals_hides(fitted: FitResult) -> None:
    noisy = replace(fitted.problem, observation=replace(fitted.problem.observation, noise_counts=50.0))
    sigmas = replace(fitted.sigmas, noise_counts=50.0, misfit=0.14)
    found = add_findings(replace(fitted, problem=noisy, sigmas=sigmas, misfit_low=0.1), dropped=0)
    told = next(f for f in found.findings if f.code == "misfit")
    assert "14 % of the signal beyond the noise" in told.text
    assert "misfit" not in _codes(add_findings(replace(fitted, misfit_low=0.03), dropped=0))


@pytest.mark.parametrize(("evidence", "told"), [([0, 5, 17], True), ([0, 1, 3], False), ([0, 17, 5], False)])
def test_spread_beyond_what_is_looked_at(fitted: FitResult, evidence: list[float], told: bool) -> None:
    density = np.exp(np.array(evidence, dtype=float))
    law = LawSpread(np.array([0.0, 0.2e-3, 0.4e-3]), density / density.sum(), np.zeros((3, 5)))
    found = add_findings(replace(fitted, law_spread_m=law.best_m, law_rise=law.rise), dropped=0)
    assert ("contact_law" in _codes(found)) == told


@pytest.mark.parametrize(
    ("power", "code"), [(0.9, "response_bends"), (1.0, "force_scatter"), (1.7, "response_bends")]
)
def test_forces_whose_errors_go_with_the_force(fitted: FitResult, power: float, code: str) -> None:
    force = fitted.problem.force_n
    off = (power - 1) * np.log(force) + np.random.default_rng(1).normal(0, 0.02, len(force))
    presses = replace(fitted.presses, force_off=off)
    found = add_findings(replace(fitted, force_low=0.05, presses=presses), dropped=0)
    told = next(f for f in found.findings if f.code in ("response_bends", "force_scatter"))
    assert told.code == code
    if power < 1:
        assert "power of 0.9" in told.text and "skincal diagnose" in told.advice
    assert ("the depth of the press" in told.advice) == (power > 1)


def test_a_straightened_response_is_reported_from_a_bound_on(fitted: FitResult) -> None:
    assert fitted.nonlinearity.rise < NONLINEAR_NATS
    found = add_findings(
        replace(fitted, nonlinearity=Nonlinearity(2.0, NONLINEAR_NATS + 1), force_low=0.05), dropped=0
    )
    [told] = [f for f in found.findings if f.code in ("response_bends", "force_scatter")]
    assert told.code == "response_bends"
    assert "2.0 times as large" in told.text and "answer less" in told.text
    assert "response_bends" not in _codes(
        add_findings(replace(fitted, nonlinearity=Nonlinearity(1.3, NONLINEAR_NATS - 1)), dropped=0)
    )


def test_forces_that_saturation_bends_scatter_next_tos(fitted: FitResult) -> None:
    """Contacts that spread over more taxels saturate less: some of what a response bends does not go with the force."""
    rng = np.random.default_rng(2)
    force = np.exp(rng.uniform(-0.4, 1.7, 60))
    off = -0.2 * np.log(force) + rng.normal(0, 0.13, 60)

    def code(off: np.ndarray, force: np.ndarray) -> str:
        problem = replace(fitted.problem, force_n=force)
        presses = replace(fitted.presses, force_off=off)
        [told] = _check_rig(replace(fitted, problem=problem, force_low=0.05, presses=presses))
        return told.code

    assert code(off, force) == "response_bends"
    # Measured forces that scatter alone: a force that is measured too high is implied too low.
    for seed in range(20):
        rng = np.random.default_rng(seed)
        true, error = rng.uniform(1, 4, 60), rng.normal(0, 0.25, 60)
        assert code(-error, true * np.exp(error)) == "force_scatter"


@pytest.mark.slow
def test_a_fit_of_one_place_gives_its_pose_no_interval(truth: Truth) -> None:
    presses, where = make_session(truth, presses=3000, seed=13)
    between = np.array([truth.across_m, truth.y_m + 2e-3])
    near = np.flatnonzero(np.abs(where - between).max(axis=1) < 0.4e-3)[:30]
    close = some_presses(presses, near)
    close.across_m[:], close.along_m[:] = where[near].T
    result = _fit(build_problem(rig(), close))
    assert "one_place" in _codes(result)
    assert all(result.intervals[name] == OPEN for name in POSE)


def test_few_presses_with_readings_to_spare_are_said(truth: Truth) -> None:
    problem = build_problem(rig(), make_session(truth, presses=200, seed=13)[0])
    keep = np.isin(np.arange(len(problem)), np.argsort(-problem.lit.sum(axis=1))[:6])
    few = problem.subset(keep, "left out")
    assert few.determined
    result = _fit(few, BOX, ONE_LAW)
    assert "few_presses" in _codes(result) and "too_few_presses" not in _codes(result)
    assert np.isfinite(list(result.intervals.values())).all()
    once = add_findings(replace(result, effective_draws=1.2), dropped=0)
    assert not once.gives_intervals
    told = next(f for f in once.findings if f.code == "few_draws")
    assert "worth only 1 independent one: too few" in told.text


def test_no_press_at_all_is_an_error(truth: Truth) -> None:
    presses, _ = make_session(truth, presses=10)
    silent = replace(presses, counts=presses.counts * 0)
    with pytest.raises(FitError, match="no press"):
        plan_grid(build_problem(rig(), silent), BOX, QUICK)


def test_a_copy_of_a_press_is_not_used(truth: Truth) -> None:
    presses, _ = make_session(truth, presses=20)
    once = build_problem(rig(), presses, min_active=2)
    twice = build_problem(rig(), some_presses(presses, np.r_[0:20, 0:20]), min_active=2)
    np.testing.assert_array_equal(twice.rows, once.rows)
    assert twice.status[20:] == ("the very numbers of another press",) * 20
    # The same press made again is another measurement.
    again = some_presses(presses, np.r_[0:20, 0:20])
    again.force_n[20:] *= 1.001
    assert len(build_problem(rig(), again, min_active=2)) == 2 * len(once)


def test_a_per_taxel_scale_finds_a_weak_taxel(truth: Truth) -> None:
    presses, _ = make_session(truth, presses=40, seed=14)
    counts = presses.counts.copy()
    counts[:, 6] = (counts[:, 6] - 0.4) * 0.8 + 0.4
    result = _fit(
        build_problem(rig(), replace(presses, counts=counts)), options=replace(ROUGH, per_taxel=True)
    )
    scales = result.scale_per_taxel_per_n
    assert scales is not None
    others = np.delete(scales, 6)
    assert scales[6] < others.min()
    assert scales[6] / np.median(others) == pytest.approx(0.8, abs=0.1)


def test_a_turned_sensor_is_found_turned(truth: Truth) -> None:
    turned = replace(truth, alpha_rad=math.radians(12.0))
    result = _fit(build_problem(rig(), make_session(turned, presses=30, seed=15)[0]), BOX, ONE_LAW)
    low, high = result.intervals["alpha_rad"]
    assert low <= math.radians(12.0) <= high


def test_unknown_force_scale_widens_elasticity_and_scale(fitted: FitResult, truth: Truth) -> None:
    sure = build_problem(rig(), make_session(truth, seed=11)[0])
    exact, wide = fitted, _fit(replace(sure, rig=replace(sure.rig, force_scale_sigma=0.05)))
    assert wide.best == exact.best
    for name in ("across_m", "y_m", "alpha_rad"):
        assert wide.intervals[name] == exact.intervals[name]
    for name in ("elasticity_pa_per_m", "scale_per_n"):
        relative = np.ptp(np.log(wide.intervals[name])) ** 2 - np.ptp(np.log(exact.intervals[name])) ** 2
        # 98 % of a Gaussian of 5 %.
        assert 0.15 < math.sqrt(relative) < 0.31


def test_a_grid_without_end_is_refused(truth: Truth) -> None:
    problem = build_problem(rig(), make_session(truth, presses=30)[0])
    fine = replace(QUICK, steps=GridSteps(1e-5, 1e-5, math.radians(0.05), 24))
    with pytest.raises(FitError, match="coarser steps"):
        plan_grid(problem, BOX, fine)
