"""The expensive terms: evidence by narrow slacks against integrals by brute force, and the chance of a selection."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp

from benchmarks.sensors import KINDS, make
from skincal.calibrate import fit_problem
from skincal.fitting import tasks
from skincal.fitting.expensive_terms import find_narrow_slacks, log_evidence, log_selection_probability
from skincal.fitting.fit_options import FitOptions, GridSteps, SearchBox
from skincal.fitting.places import find_places
from skincal.fitting.posterior import press_evidence
from skincal.fitting.presses import PressModel
from skincal.fitting.problem import FitProblem, build_problem
from skincal.fitting.sampling import Draws, smooth_term
from skincal.fitting.solve import solve
from skincal.fitting.tasks import Neighbourhood
from skincal.model import Contacts, Cylinder, Sphere
from tests.fitting.conftest import LAYOUT, QUICK, RADIUS, Truth, make_session, rig, skin
from tests.fitting.test_press_places import SIGMAS, by_brute_force

SESSION_SIGMAS = np.array([0.5e-3, 0.003, math.sqrt(1 + 1 / 12), 1e-4, 1e-4, 1e-8])
COARSE = np.array([0.4e-3, 0.002, 1.0, 1e-4, 1e-4, 2e-5])
"""Noise of single frames, and contacts that are placed by hand."""


def test_presses_of_one_taxel_have_the_mass_of_the_integral() -> None:
    """Their contact lies on a ring, which Laplace's approximation takes for a line."""
    truth = Truth()
    table = make_session(truth, presses=40, seed=21, position_sigma_m=0.7e-3)[0]
    problem = build_problem(rig(), table, min_active=1)
    problem = problem.subset(problem.active[problem.rows] == 1, "two taxels")
    assert len(problem) >= 8
    macro = truth.macro
    model = Neighbourhood.around(macro).model(problem)
    places = find_places(model, macro, SIGMAS)
    slacks = find_narrow_slacks(model, places, macro, SIGMAS)
    point, offset = np.concatenate([macro, np.log(SIGMAS)]), 2 * math.log(SIGMAS[0]) + math.log(SIGMAS[1])
    off, roughly = list[float](), list[float]()
    for k in range(8):
        one = PressModel(problem.subset(np.arange(len(problem)) == k, "another press"), model.tables)
        exact = by_brute_force(one, macro, 0) - offset
        mine = slacks.at.press == k
        at = replace(
            slacks.at,
            **{n: v[mine] for n, v in vars(slacks.at).items()} | {"press": np.zeros(mine.sum(), int)},
        )
        own = replace(slacks, at=at, centre_m=slacks.centre_m[mine], omega_m=slacks.omega_m[mine])
        off.append(float(log_evidence(one, own, point[None])[0]) - exact)
        there = find_places(one, macro, SIGMAS)
        roughly.append(float(press_evidence(one, there, point[None])[0][0]) - exact)
    # A constant factor is no matter; what differs from press to press is.
    assert np.std(off) < 0.08
    assert np.std(roughly) > 2 * np.std(off)


def test_a_press_at_the_middle_of_a_taxel_tells_e() -> None:
    """A bend of what is left has the same sign over the middle of every taxel, and would draw E by it."""
    truth, step = Truth(alpha_rad=0.0), 0.02
    table = make_session(truth, presses=40, seed=22)[0]
    across, along = np.array([truth.across_m, truth.y_m])[:, None] + LAYOUT.centres_m[[5, 6, 9]].T
    points = np.stack([RADIUS * np.sin(across / RADIUS), along, RADIUS * np.cos(across / RADIUS)], axis=1)
    contacts = Contacts(points, Cylinder(RADIUS).normal_at(points), np.full(3, 3.0))
    table.across_m[:3], table.along_m[:3], table.force_n[:3] = across, along, 3.0
    table.counts[:3] = skin(truth).values(Sphere(0.006), contacts)
    problem = build_problem(rig(), table, min_active=1)
    problem = problem.subset(problem.rows < 3, "not in the middle")
    macro = truth.macro
    model = Neighbourhood.around(macro).model(problem)
    at = macro + step * np.outer([1.0, -1.0], np.eye(5)[3])
    slacks = find_narrow_slacks(model, find_places(model, macro, COARSE), macro, COARSE)
    told = log_evidence(model, slacks, np.column_stack([at, np.tile(np.log(COARSE), (2, 1))]))
    exact = [sum(_integral(model, point, k) for k in range(3)) for point in at]
    assert told[0] - told[1] == pytest.approx(exact[0] - exact[1], rel=0.02)


def _integral(model: PressModel, macro: np.ndarray, press: int) -> float:
    """Log of the integral over slack and force by a lattice of 10 um about the measured place."""
    axis = np.arange(-0.6e-3, 0.6e-3, 1e-5)
    slack = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    n = len(slack)
    nuisance = np.column_stack([slack, np.zeros(n)])
    state = model.evaluate(macro, COARSE, np.full(n, press), nuisance)
    slope = state.nuisance_slope[:, :, 2]
    stiffness = (slope**2).sum(axis=1) + 1 / COARSE[1] ** 2
    objective = state.objective - (slope * state.residual).sum(axis=1) ** 2 / stiffness
    return float(logsumexp(-objective / 2 - np.log(stiffness) / 2))


def test_a_term_that_is_known_at_some_draws_moves_all() -> None:
    rng = np.random.default_rng(0)
    points = rng.standard_normal((4000, 11)) * np.array([1e-4, 1e-4, 0.02, 0.05, 0.01, *[0.3] * 6])
    draws = Draws(points, np.full(4000, 1 / 4000))

    def rising(at: np.ndarray) -> np.ndarray:
        rise = 0.5 * at[:, 3] / 0.05 + 0.4 * rng.standard_normal(200)
        rise[:3] = [-60.0, np.inf, 40.0]
        return rise

    weight = np.exp(smooth_term(draws, rising, 200, rng)(points))
    moved = Draws(points, weight / weight.sum())
    assert abs(moved.mean[3] / 0.05 - 0.5) < 0.15
    assert abs(moved.mean[4] / 0.01) < 0.15
    assert moved.effective > 2500


def _session(presses: int, seed: int) -> tuple[FitProblem, np.ndarray]:
    """Presses on a plane that were chosen, and the true point."""
    kind = replace(KINDS["plane"], presses=presses)
    session, truth = make(np.random.default_rng(seed), kind)
    macro = [truth.across_m, truth.y_m, truth.alpha_rad]
    macro += [math.log(truth.elasticity_pa_per_m), math.log(truth.scale_per_n)]
    return fit_problem(session, FitOptions()), np.concatenate([macro, np.log(SESSION_SIGMAS)])


def test_chance_is_what_counting_gives() -> None:
    problem, point = _session(80, 3)
    tables, rng = Neighbourhood.around(point[:5]).model(problem).tables, np.random.default_rng(0)
    for k in range(0, len(problem), 10):
        one = PressModel(problem.subset(np.arange(len(problem)) == k, "another press"), tables)
        slack = rng.standard_normal((2000, 3)) * SESSION_SIGMAS[[0, 0, 1]]
        state = one.evaluate(point[:5], SESSION_SIGMAS, np.zeros(2000, dtype=np.intp), slack)
        read = state.simulated + SESSION_SIGMAS[2] * rng.standard_normal(state.simulated.shape)
        counted = ((read >= problem.active_above).sum(axis=1) >= problem.min_active).mean()
        assert abs(math.exp(log_selection_probability(one, point[None])[0]) - counted) < 0.04


def test_a_fit_knows_how_its_presses_were_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stiff skin lights fewer second taxels: without the choice of presses, E comes out too low."""
    problem, _ = _session(60, 8)
    box = SearchBox((-2.5e-3, 2.5e-3), (0.0275, 0.0325), (-0.35, 0.35))
    quick = replace(QUICK, steps=GridSteps(2.5e-3, 2.5e-3, 0.35, 3), law_spreads_m=(0.0,), rounds=(4, 8))
    chosen = solve(problem, box, quick, np.random.default_rng(0))
    monkeypatch.setattr(tasks, "log_selection_probability", lambda _model, points: np.zeros(len(points)))
    taken = solve(problem, box, quick, np.random.default_rng(0))
    spread = np.log(taken.draws[:, 3]).std()
    off = math.log(chosen.best["elasticity_pa_per_m"] / taken.best["elasticity_pa_per_m"]) / spread
    assert 0.15 < off < 0.8
