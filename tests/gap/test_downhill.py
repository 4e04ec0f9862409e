"""Steps within bounds are the best of those that are."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from skincal.gap.downhill import bounded_step


@pytest.mark.parametrize("seed", range(20))
def test_a_step_stays_within_bounds_and_what_is_free_is_best_then(seed: int):
    rng = np.random.default_rng(seed)
    slopes, residual = rng.normal(size=(30, 6)), 4 * rng.normal(size=30)
    low, high = -rng.uniform(0.0, 0.6, 6), rng.uniform(0.0, 0.6, 6)
    low[:3], high[:3] = -np.inf, np.inf
    low[3] = high[4] = 0.0
    step = bounded_step(slopes.T @ slopes, slopes.T @ residual, low, high)
    assert ((step >= low) & (step <= high)).all()
    inside = (step > low) & (step < high)
    assert np.abs((slopes.T @ (residual - slopes @ step))[inside]).max() < 1e-9
    # No step within bounds is better by much: the active set only grows.
    best = lsq_linear(slopes, residual, (low - 1e-12, high + 1e-12)).x
    cost, least = (float(((residual - slopes @ one) ** 2).sum()) for one in (step, best))
    clipped = np.clip(np.linalg.solve(slopes.T @ slopes, slopes.T @ residual), low, high)
    assert least <= cost + 1e-9 <= 1e-9 + float(((residual - slopes @ clipped) ** 2).sum()) + 1e-9
    assert cost < 1.05 * least


def test_without_bounds_it_is_newtons_and_with_no_room_it_is_none():
    curve, pull = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([1.0, -2.0])
    wide = np.full(2, np.inf)
    assert bounded_step(curve, pull, -wide, wide) == pytest.approx(np.linalg.solve(curve, pull))
    assert (bounded_step(curve, pull, np.zeros(2), np.zeros(2)) == 0.0).all()
    assert len(bounded_step(np.zeros((0, 0)), np.zeros(0), np.zeros(0), np.zeros(0))) == 0
