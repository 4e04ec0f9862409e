"""A response that bends is told from hold means alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.fitting.fit_findings import BENT_NATS
from skincal.fitting.observe import Readout
from skincal.fitting.posterior import Bounds
from skincal.fitting.problem import FitProblem, pose_problem
from skincal.fitting.straight import BENDS, Bend, straightened, weigh_bends
from skincal.fitting.tasks import Neighbourhood, climb_near
from tests.fitting.conftest import BOX, Truth, make_session, rig

UNCLIPPED = Readout(None, None, False)


def bent_problem(ceiling: float | None, seed: int = 0) -> FitProblem:
    """Presses whose values x are read as x / (1 + (x / c)^4)^(1/4), resting at 20 counts."""
    table, _ = make_session(presses=40, seed=seed, noise=0.0)
    counts = table.counts
    if ceiling is not None:
        counts = counts / (1 + (counts / ceiling) ** 4) ** 0.25
    counts = 20.0 + counts + 0.3 * np.random.default_rng(seed).standard_normal(counts.shape)
    return pose_problem(rig(UNCLIPPED), replace(table, counts=counts))


def bend_of(problem: FitProblem, truth: Truth) -> Bend:
    start = np.array(
        [truth.across_m, truth.y_m, truth.alpha_rad, *np.log([truth.elasticity_pa_per_m, truth.scale_per_n])]
    )
    low = np.array([BOX.across_m[0], BOX.y_m[0], BOX.alpha_rad[0], *(start[3:] - 3)])
    high = np.array([BOX.across_m[1], BOX.y_m[1], BOX.alpha_rad[1], *(start[3:] + 3)])
    bounds, around = Bounds(low, high), Neighbourhood.around(start)
    peak = climb_near(problem, bounds, start, around)
    peak = climb_near(problem, bounds, peak.macro, around, peak.sigmas)
    straight = [straightened(problem, *bend) for bend in BENDS]
    peaks = [climb_near(one, bounds, peak.macro, around, peak.sigmas) for one, _ in straight]
    return weigh_bends([peak], peaks, [jacobian for _, jacobian in straight])


@pytest.mark.parametrize(("ceiling", "bends"), [(60.0, True), (None, False)])
def test_bends_show_in_hold_means(truth: Truth, ceiling: float | None, bends: bool) -> None:
    found = bend_of(bent_problem(ceiling), truth)
    assert (found.rise > BENT_NATS) == bends
    assert not bends or found.grows > 1


@pytest.mark.parametrize(("part", "power"), BENDS)
def test_jacobian_of_straightened_readings(part: float, power: int) -> None:
    problem, step = bent_problem(None), 1e-6
    largest = problem.values == problem.values.max()
    more = replace(problem, values=problem.values + np.where(largest, 0.0, step))
    straight, log_jacobian = straightened(problem, part, power)
    moved = (straightened(more, part, power)[0].values - straight.values) / step
    told = problem.used & (problem.values > 0) & ~largest
    expected = log_jacobian - np.log(1 + (1 + power) * part)
    assert np.log(moved[told]).sum() == pytest.approx(expected, abs=0.05)
