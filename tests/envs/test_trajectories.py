"""Targets: where they are, and how fast they move."""

from __future__ import annotations

import numpy as np
import pytest

from skincal.envs.trajectories import SPEED_M_PER_S, circle, sine, wander


@pytest.mark.parametrize("half_width_m", [3e-3, 6e-3])
def test_random_targets_cover_the_box_from_its_centre(half_width_m: float) -> None:
    rng = np.random.default_rng(0)
    ways = np.stack([wander(rng, 61, half_width_m) for _ in range(200)])
    assert ways.shape == (200, 61, 2)
    assert np.all(ways[:, 0] == 0)
    assert np.abs(ways).max() <= half_width_m
    speed = 10 * np.linalg.norm(np.diff(ways, axis=1), axis=2)
    assert speed.max() <= SPEED_M_PER_S[1] * (1 + 1e-9)
    late = ways[:, -1]
    assert np.all(late.max(axis=0) > 0.7 * half_width_m) and np.all(late.min(axis=0) < -0.7 * half_width_m)
    assert np.abs(late.mean(axis=0)).max() < 0.25 * half_width_m


def test_the_circle_is_the_evaluation_of_the_paper() -> None:
    way = circle(81)
    assert way[0] == pytest.approx([0, 0])
    assert way[10] == pytest.approx([2.5e-3, 0])
    assert way[20] == pytest.approx([5e-3, 0])
    assert np.linalg.norm(way[20:], axis=1) == pytest.approx(5e-3)
    assert way[35] == pytest.approx([0, 5e-3], abs=1e-12)
    assert way[80] == pytest.approx([5e-3, 0], abs=1e-12)


def test_the_sine_has_its_amplitude_and_frequency() -> None:
    way = sine(241, 0.25)[:, 0]
    assert way[[0, 10, 20, 30, 40]] == pytest.approx([0, 6e-3, 0, -6e-3, 0], abs=1e-12)
