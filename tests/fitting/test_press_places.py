"""Evidence of single presses against integrals by brute force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import logsumexp

from skincal.fitting.laplace import Fold, log_volume, measure_fold, weigh_untracked_mirrors
from skincal.fitting.places import find_duplicates, find_places, find_tracked_mirrors
from skincal.fitting.presses import Places, PressModel
from skincal.fitting.problem import build_problem
from skincal.fitting.tasks import Neighbourhood
from tests.fitting.conftest import Truth, make_session, rig

SIGMAS = np.array([0.7e-3, 0.005, 0.22, 0.002, 0.01, 2e-5])


def by_brute_force(model: PressModel, macro: np.ndarray, press: int) -> float:
    """Log of the integral over slack and force, on a lattice refined to 2.5 um where it matters."""

    def told(slack: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        n = len(slack)
        nuisance = np.column_stack([slack, np.zeros(n)])
        state = model.evaluate(macro, SIGMAS, np.full(n, press), nuisance)
        # The force acts almost linearly: its integral is a Gaussian's.
        slope = state.nuisance_slope[:, :, 2]
        stiffness = (slope**2).sum(axis=1) + 1 / SIGMAS[1] ** 2
        gradient = (slope * state.residual).sum(axis=1)
        return state.objective - gradient**2 / stiffness, stiffness

    def lattice(centres: np.ndarray, step: float, parts: int) -> np.ndarray:
        inner = ((np.arange(parts) + 0.5) / parts - 0.5) * step
        return (centres[:, None] + np.stack(np.meshgrid(inner, inner), axis=-1).reshape(1, -1, 2)).reshape(
            -1, 2
        )

    step = model.problem.rig.slack_m * 2
    slack = np.zeros((1, 2))
    for parts, margin in ((80, 2500.0), (4, 300.0), (5, np.inf)):
        slack, step = lattice(slack, step, parts), step / parts
        objective, stiffness = told(slack)
        slack = slack[objective < objective.min() + margin]
    integral = logsumexp(-objective / 2 - np.log(stiffness) / 2) + 2 * math.log(step)
    return float(integral - math.log(2 * math.pi))


def by_places(model: PressModel, macro: np.ndarray, places: Places) -> np.ndarray:
    state = model.fit_at_places(places, macro[None], SIGMAS[None], iterations=12)
    fold = measure_fold(model, state)
    tracked = find_tracked_mirrors(places.press, state.nuisance[:, :2], fold.mirror_m, 1)
    mirror = weigh_untracked_mirrors(model, state, fold, tracked)
    evidence = -0.5 * state.objective + log_volume(fold, mirror)
    evidence[find_duplicates(places.press, state.uv_m[None], fold)[0]] = -np.inf
    return np.array([logsumexp(evidence[places.press == k]) for k in range(len(model.problem))])


@pytest.mark.parametrize("scale", [1.0, 0.98])
def test_places_have_the_mass_of_the_integral(scale: float) -> None:
    truth = Truth(scale_per_n=68.0 * scale)
    problem = build_problem(rig(), make_session(Truth(), presses=30, seed=21, position_sigma_m=0.7e-3)[0])
    macro = truth.macro
    model = Neighbourhood.around(macro).model(problem)
    places = find_places(model, macro, SIGMAS)
    assert len(places.press) > len(problem)
    exact = np.array([by_brute_force(model, macro, k) for k in range(len(problem))])
    off = by_places(model, macro, places) - exact
    assert np.median(np.abs(off)) < 0.05
    assert np.abs(off).max() < 0.75
    assert abs(off.sum()) < 1.5


def test_a_low_scale_gains_no_places_that_are_not_there() -> None:
    """Of a low scale most presses lie at a fold. Mirror places that other taxels rule out would speak for it."""
    truth = Truth()
    problem = build_problem(rig(), make_session(truth, presses=40, seed=3, position_sigma_m=0.6e-3)[0])
    off = []
    for log_e, log_s in ((0.0, 0.0), (-0.1, -0.03)):
        macro = truth.macro + np.array([0.0, 0.0, 0.0, log_e, log_s])
        model = Neighbourhood.around(macro).model(problem)
        places = find_places(model, macro, SIGMAS)
        exact = np.array([by_brute_force(model, macro, k) for k in range(len(problem))])
        off.append(float((by_places(model, macro, places) - exact).sum()))
    assert off[1] - off[0] < 1.0


def fold(a: list[float]) -> Fold:
    n = len(a)
    ones = np.ones(n)
    return Fold(ones, ones, ones, ones, np.array(a), np.zeros((n, 2)))


def test_a_place_counts_once() -> None:
    press = np.array([0, 0, 0, 1])
    uv = np.array([[[0.0, 0.0], [0.01e-3, 0.0], [0.2e-3, 0.0], [0.0, 0.0]]])
    apart = find_duplicates(press, uv, fold([3.0, 3.0, 3.0, 3.0]))
    assert apart.tolist() == [[False, True, False, False]]
    at_the_fold = find_duplicates(press, uv, fold([-1.0, -1.0, -1.0, -1.0]))
    assert at_the_fold.tolist() == [[False, True, True, False]]


def test_brief_search_finds_the_whole_objective() -> None:
    """Taxels out of reach of a contact are looked at once, and count like the others."""
    problem = build_problem(rig(), make_session(presses=12)[0])
    macro = np.tile(Truth().macro, (len(problem), 1))
    model, press = Neighbourhood.around(macro[0]).model(problem), np.arange(len(problem))
    sigmas = np.tile(SIGMAS, (len(problem), 1))
    start = np.full((len(problem), 3), 1e-4)
    state = model.fit_nuisance(macro, sigmas, press, start, iterations=3)
    own = ((state.nuisance - problem.shared.centre) / SIGMAS[[0, 0, 1]]) ** 2
    assert state.objective == pytest.approx((state.residual**2).sum(axis=1) + own.sum(axis=1), rel=1e-9)
    again = model.evaluate(macro, sigmas, press, state.nuisance)
    assert again.residual == pytest.approx(state.residual, rel=1e-12, abs=1e-12)
    brief = model.fit_nuisance(macro, sigmas, press, start, iterations=3, brief=True)
    assert np.array_equal(brief.nuisance, state.nuisance) and np.array_equal(brief.hessian, state.hessian)
    assert brief.objective == pytest.approx(state.objective, rel=1e-12)
    assert len(brief.residual) == 0
