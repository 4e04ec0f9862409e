"""A response that bends is told from hold means alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from skincal.fitting.alternatives import (
    Nonlinearity,
    candidate_responses,
    invert_response,
    weigh_responses,
    with_response,
)
from skincal.fitting.fit_findings import NONLINEAR_NATS
from skincal.fitting.observe import Readout
from skincal.fitting.posterior import Bounds, Peak
from skincal.fitting.problem import FitProblem, build_problem
from skincal.fitting.readings import STRAIGHT
from skincal.fitting.tasks import Neighbourhood, climb_near
from tests.fitting.conftest import BOX, Truth, make_session, rig

UNCLIPPED = Readout(None, None, False)
Curve = Callable[[np.ndarray], np.ndarray]


def bent_problem(curve: Curve | None, seed: int = 0) -> FitProblem:
    """Presses whose values are read by a curve, resting at 20 counts."""
    table, _ = make_session(presses=40, seed=seed, noise=0.0)
    counts = table.counts if curve is None else curve(table.counts)
    counts = 20.0 + counts + 0.3 * np.random.default_rng(seed).standard_normal(counts.shape)
    return build_problem(rig(UNCLIPPED), replace(table, counts=counts))


CURVES: dict[str, tuple[Curve | None, int]] = {
    "straight": (None, 0),
    "saturates": (lambda x: x / (1 + (x / 60) ** 4) ** 0.25, 1),
    "power 0.8": (lambda x: 60 * (x / 60) ** 0.8, 1),
    "power 1.4": (lambda x: 60 * (x / 60) ** 1.4, -1),
}
"""Curves, and whether they bend down, up or not at all."""


@cache
def climbed(name: str) -> tuple[FitProblem, Peak, list[Peak]]:
    """Presses that are read by a curve, the peak of a straight response, and those of all."""
    problem, start = bent_problem(CURVES[name][0]), Truth().macro
    low = np.array([BOX.across_m[0], BOX.y_m[0], BOX.alpha_rad[0], *(start[3:] - 3)])
    high = np.array([BOX.across_m[1], BOX.y_m[1], BOX.alpha_rad[1], *(start[3:] + 3)])
    bounds, around = Bounds(low, high), Neighbourhood.around(start)
    peak = climb_near(problem, bounds, start, around)
    peak = climb_near(problem, bounds, peak.macro, around, peak.sigmas)
    tried = (with_response(problem, one) for one in candidate_responses(problem))
    return problem, peak, [climb_near(one, bounds, peak.macro, around, peak.sigmas) for one in tried]


@pytest.mark.parametrize("name", CURVES)
def test_bends_show_in_hold_means(name: str) -> None:
    bends, (problem, peak, peaks) = CURVES[name][1], climbed(name)
    found = weigh_responses(problem, [peak], candidate_responses(problem), peaks)
    assert (found.rise > NONLINEAR_NATS) == (bends != 0)
    assert not bends or np.sign(found.grows - 1) == bends


def test_the_best_response_has_the_elasticity(truth: Truth) -> None:
    """E of a straight response is half of the truth where readings grow as the load to the power 0.8."""
    _, peak, peaks = climbed("power 0.8")
    best = max(peaks, key=lambda one: one.log_evidence)
    off = [np.log(truth.elasticity_pa_per_m) - one.macro[3] for one in (peak, best)]
    assert off[0] > 0.4 and abs(off[1]) < 0.3


def test_a_bend_that_no_peak_likes_better_is_none() -> None:
    problem = bent_problem(None)
    peak = type("Peak", (), {"log_evidence": -3.0, "macro": np.zeros(5)})
    lost = type("Peak", (), {"log_evidence": np.nan, "macro": np.zeros(5)})
    tried = candidate_responses(problem)[:2]
    assert weigh_responses(problem, [peak, lost], tried, [peak, lost]) == Nonlinearity()  # type: ignore[list-item]


def test_typical_readings_stay() -> None:
    problem = bent_problem(None)
    typical = problem.observation.typical_counts
    straight, *bent = candidate_responses(problem)
    assert straight == STRAIGHT
    for response in bent:
        assert response.of(typical) == pytest.approx(typical)
        assert response.of(0.0) == 0.0
        assert response.of(invert_response(response, typical / 3)) == pytest.approx(typical / 3)


def test_images_by_a_response(truth: Truth) -> None:
    """Compiled values are those of the formula; slopes are a straight response's times that of the formula."""
    problem = bent_problem(None)
    start, sigmas = truth.macro, np.array([5e-4, 0.01, 0.3, 0.01, 0.01, 1e-5])
    press, nuisance = np.arange(len(problem)), np.zeros((len(problem), 3))
    around, step = Neighbourhood.around(start), 1e-4
    straight = around.model(problem).evaluate(start, sigmas, press, nuisance)
    for response in candidate_responses(problem):
        bent = around.model(with_response(problem, response)).evaluate(start, sigmas, press, nuisance)
        low, value, high = (np.vectorize(response.of)(straight.simulated + s) for s in (-step, 0.0, step))
        np.testing.assert_allclose(bent.simulated, value, rtol=1e-9)
        told = straight.simulated > 2 * step
        for name in ("macro_slope", "nuisance_slope"):
            slopes = getattr(straight, name)[told] * ((high - low) / (2 * step))[told][:, None]
            np.testing.assert_allclose(getattr(bent, name)[told], slopes, rtol=1e-5, atol=1e-9)
