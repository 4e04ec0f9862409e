"""Figures of an evaluation: means over what still goes on, intervals, directions of a bolt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.train.scores import Runs, direction_right, rolling, score


def make_runs(error_m: np.ndarray, dropped: np.ndarray | None = None, **parts: np.ndarray) -> Runs:
    n, t = error_m.shape
    lost = np.zeros(n, bool) if dropped is None else dropped
    still = {"object_m": np.zeros((n, t, 2)), "target_m": np.zeros((n, t, 2)), "rewards": np.ones(n)}
    return replace(Runs.empty(n, t, 10.0), error_m=error_m, dropped=lost, **(still | parts))


def test_means_are_over_the_runs_still_going():
    error = np.full((4, 80), 1e-3)
    error[0] = 3e-3
    error[0, 10:] = np.nan
    found = score(make_runs(error, np.array([True, False, False, False])), np.random.default_rng(1))
    assert found.error_m[:10] == pytest.approx(1.5e-3)
    assert found.error_m[10:] == pytest.approx(1e-3)
    assert (found.episodes, found.drops, found.success) == (4, 1, 0.75)
    assert found.error_settled_m == pytest.approx(1e-3)
    assert found.error_end_m == pytest.approx(1e-3)


def test_settled_is_from_two_to_eight_seconds():
    error = np.tile(np.where(0.1 * np.arange(1, 81) < 1.95, 9e-3, 1e-3), (3, 1))
    assert score(make_runs(error), np.random.default_rng(1)).error_settled_m == pytest.approx(1e-3)


def test_nothing_goes_on():
    error = np.full((2, 80), np.nan)
    error[:, :5] = 1e-3
    found = score(make_runs(error, np.array([True, True])), np.random.default_rng(1))
    assert np.isnan(found.error_end_m)
    assert np.isnan(found.error_settled_m)


def test_intervals_hold_the_truth():
    """In about 95 of 100 evaluations the interval of 60 runs holds the mean of all runs."""
    rng = np.random.default_rng(3)
    hits = []
    for _ in range(100):
        error = rng.gamma(4.0, 0.25e-3, (60, 1)) * np.ones((1, 80))
        found = score(make_runs(error), rng)
        hits.append(found.error_low_m[40] <= 1e-3 <= found.error_high_m[40])
        low, high = found.error_settled_interval_m
        assert low < found.error_settled_m < high
    assert 86 <= sum(hits) <= 100


def line(degrees: float, share: float = 1.0, steps: int = 60) -> np.ndarray:
    s = share * 6e-3 * np.sin(2 * np.pi * 0.4 * 0.1 * np.arange(steps))
    return s[:, None] * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])


@pytest.mark.parametrize(
    ("turned", "share", "right"),
    [
        (0, 1, True),
        (20, 1, True),
        (25, 1, False),
        (90, 1, False),
        (180, 1, False),
        (0, 0.3, True),
        (0, 0.2, False),
    ],
)
@pytest.mark.parametrize("orientation", [-45, 0, 45, 90])
def test_direction(orientation, turned, share, right):
    noise = 1e-4 * np.random.default_rng(1).normal(size=(60, 2))
    assert direction_right(line(orientation + turned, share) + noise, line(orientation)) is right


def test_direction_of_a_short_run():
    place = line(0)
    place[2:] = np.nan
    assert not direction_right(place, line(0))
    assert not direction_right(line(0), np.zeros((60, 2)))


def test_rolling_by_orientation():
    orientation = np.array([-45.0, -45.0, 90.0])
    targets = np.stack([line(o) for o in orientation])
    objects = targets.copy()
    objects[1] *= -1
    error = np.zeros((3, 60))
    error[2, 30:] = np.nan
    runs = make_runs(
        error,
        np.array([False, False, True]),
        object_m=objects,
        target_m=targets,
        orientation_deg=orientation,
        angle_error_rad=np.full((3, 60), -0.1),
    )
    found = rolling(runs)
    assert found.direction_right == pytest.approx(2 / 3)
    assert found.held_to_end == pytest.approx(2 / 3)
    assert found.angle_error_rad == pytest.approx(0.1)
    assert list(found.by_orientation_deg) == ["-45", "90"]
    assert found.by_orientation_deg["-45"].direction_right == 0.5
    assert found.by_orientation_deg["90"].held_s == pytest.approx(3.0)
    assert found.by_orientation_deg["90"].drops == 1
