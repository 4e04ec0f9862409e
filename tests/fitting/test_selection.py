"""Presses are chosen by what they read: the chance of that against counting, and what it does to E."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.sensors import KINDS, make
from skincal.calibrate import fit_problem
from skincal.fitting import tasks
from skincal.fitting.fit_options import FitOptions, GridSteps, SearchBox
from skincal.fitting.presses import PressModel
from skincal.fitting.problem import FitProblem
from skincal.fitting.selection import log_selection_probability
from skincal.fitting.solve import solve
from skincal.fitting.tasks import Neighbourhood
from tests.fitting.conftest import QUICK

SIGMAS = np.array([0.5e-3, 0.003, math.sqrt(1 + 1 / 12), 1e-4, 1e-4, 1e-8])


def _session(presses: int, seed: int) -> tuple[FitProblem, np.ndarray]:
    """Presses on a plane that were chosen, and the true point."""
    kind = replace(KINDS["plane"], presses=presses)
    session, truth = make(np.random.default_rng(seed), kind)
    macro = [truth.across_m, truth.y_m, truth.alpha_rad]
    macro += [math.log(truth.elasticity_pa_per_m), math.log(truth.scale_per_n)]
    return fit_problem(session, FitOptions()), np.concatenate([macro, np.log(SIGMAS)])


def test_chance_is_what_counting_gives() -> None:
    problem, point = _session(80, 3)
    tables, rng = Neighbourhood.around(point[:5]).model(problem).tables, np.random.default_rng(0)
    for k in range(0, len(problem), 10):
        one = PressModel(problem.subset(np.arange(len(problem)) == k, "another press"), tables)
        slack = rng.standard_normal((2000, 3)) * SIGMAS[[0, 0, 1]]
        state = one.evaluate(point[:5], SIGMAS, np.zeros(2000, dtype=np.intp), slack)
        read = state.simulated + SIGMAS[2] * rng.standard_normal(state.simulated.shape)
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
