"""The evidence of presses by narrow slacks against integrals by brute force, and what it does to draws."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from skincal.fitting.places import find_places
from skincal.fitting.posterior import press_evidence
from skincal.fitting.press_evidence import find_narrow_slacks, log_evidence
from skincal.fitting.problem import pose_problem
from skincal.fitting.sampling import Draws, Lacking, smooth_term
from skincal.fitting.tasks import Neighbourhood
from tests.fitting.conftest import Truth, make_session, rig
from tests.fitting.test_press_places import SIGMAS, by_brute_force


def test_presses_of_one_taxel_have_the_mass_of_the_integral() -> None:
    """Their contact lies on a ring, which Laplace's approximation takes for a line."""
    truth = Truth()
    table = make_session(truth, presses=40, seed=21, position_sigma_m=0.7e-3)[0]
    problem = pose_problem(rig(), table, min_active=1)
    problem = problem.subset(problem.active[problem.rows] == 1, "two taxels")
    assert len(problem) >= 8
    macro = np.array([
        truth.across_m, truth.y_m, truth.alpha_rad, math.log(truth.elasticity_pa_per_m), math.log(truth.scale_per_n)
    ])  # fmt: skip
    images = Neighbourhood.around(macro).images(problem)
    places = find_places(problem, images, macro, SIGMAS)
    slacks = find_narrow_slacks(problem, images, places, macro, SIGMAS)
    point, offset = np.concatenate([macro, np.log(SIGMAS)]), 2 * math.log(SIGMAS[0]) + math.log(SIGMAS[1])
    off, roughly = list[float](), list[float]()
    for k in range(8):
        one = problem.subset(np.arange(len(problem)) == k, "another press")
        exact = by_brute_force(one, images, macro, 0) - offset
        mine = slacks.press == k
        at = replace(
            slacks.at,
            **{n: v[mine] for n, v in vars(slacks.at).items()} | {"press": np.zeros(mine.sum(), int)},
        )
        own = replace(
            slacks, press=at.press, centre_m=slacks.centre_m[mine], omega_m=slacks.omega_m[mine], at=at
        )
        off.append(float(log_evidence(one, images, own, point[None])[0]) - exact)
        there = find_places(one, images, macro, SIGMAS)
        roughly.append(float(press_evidence(one, images, there, point[None])[0][0]) - exact)
    # A constant factor is no matter; what differs from press to press is.
    assert np.std(off) < 0.08
    assert np.std(roughly) > 2 * np.std(off)


def test_a_term_that_is_known_at_some_draws_moves_all() -> None:
    rng = np.random.default_rng(0)
    points = rng.standard_normal((4000, 11)) * np.array([1e-4, 1e-4, 0.02, 0.05, 0.01, *[0.3] * 6])
    draws = Draws(points, np.full(4000, 1 / 4000))

    def rising(at: np.ndarray) -> np.ndarray:
        rise = 0.5 * at[:, 3] / 0.05 + 0.4 * rng.standard_normal(200)
        rise[:3] = [-60.0, np.inf, 40.0]
        return rise

    weight = np.exp(smooth_term(draws, Lacking(rising, 200), rng)(points))
    moved = Draws(points, weight / weight.sum())
    assert abs(moved.mean[3] / 0.05 - 0.5) < 0.15
    assert abs(moved.mean[4] / 0.01) < 0.15
    assert moved.effective > 2500
