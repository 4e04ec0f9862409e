"""How far a smooth error of the measured positions leaves the sensor's turn open."""

from __future__ import annotations

import numpy as np
import pytest

from skincal.fit.warp import turn_sigma


def presses(seed: int, count: int = 40) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return *rng.uniform(-6e-3, 6e-3, (2, count)), rng


def test_errors_that_are_independent_leave_nothing_open():
    found = []
    for seed in range(200):
        across, along, rng = presses(seed)
        found.append(turn_sigma(across, along, 0.3e-3 * rng.standard_normal((40, 2))))
    assert np.mean(np.array(found) > 0) < 0.04


def test_a_gradient_says_how_large_a_turn_may_be():
    turns, sigmas = [], []
    for seed in range(300):
        across, along, rng = presses(seed)
        gradient = 0.02 * rng.standard_normal((2, 2))
        slack = np.stack([across, along], axis=1) @ gradient + 0.05e-3 * rng.standard_normal((40, 2)) + 0.4e-3
        turns.append((gradient[0, 1] - gradient[1, 0]) / 2)
        sigmas.append(turn_sigma(across, along, slack))
    assert np.sqrt(np.mean(np.square(sigmas))) == pytest.approx(np.std(turns), rel=0.1)


def test_a_turn_itself_shows_nothing():
    across, along, _ = presses(0)
    turned = 0.03 * np.stack([along, -across], axis=1)
    assert turn_sigma(across, along, turned + 1e-6 * np.random.default_rng(1).standard_normal((40, 2))) == 0.0


def test_few_presses_and_presses_on_a_line_say_nothing():
    across, along, _ = presses(0, 7)
    assert turn_sigma(across, along, np.stack([0.03 * across, 0 * along], axis=1)) == 0.0
    line = np.linspace(-5e-3, 5e-3, 20)
    assert turn_sigma(line, line, np.stack([0.03 * line, line], axis=1)) == 0.0


@pytest.mark.filterwarnings("error")
def test_presses_at_one_place_say_nothing():
    slack = 0.3e-3 * np.random.default_rng(0).standard_normal((20, 2))
    one, line = np.full(20, 2e-3), np.linspace(-5e-3, 5e-3, 20)
    for across, along in ((one, one), (one, line), (line, one)):
        assert turn_sigma(across, along, slack) == 0.0
