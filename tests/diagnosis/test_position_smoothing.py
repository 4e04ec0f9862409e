"""Smoothing of the contact positions of frames."""

from __future__ import annotations

import numpy as np
import pytest

from skincal.diagnosis.dataset_session import smooth_positions
from skincal.effects.samples import HOLD, LOAD, UNLOAD

FORCE = np.concatenate([np.linspace(0.2, 3.0, 20), np.full(30, 3.0), np.linspace(3.0, 0.2, 20)])
PHASE = np.repeat([LOAD, HOLD, UNLOAD], [20, 30, 20])


def pressed(slope_m_per_n: float, noise_m: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return true and measured positions (70, 3) [m] of a press."""
    along = np.array([0.3, 1.0, 0.1])
    true = np.array([1e-3, 0.0235, 0.0115]) + slope_m_per_n * FORCE[:, None] * along
    return true, true + noise_m * np.random.default_rng(seed).standard_normal(true.shape)


def test_noise_is_removed_and_drift_with_force_stays():
    true, measured = pressed(1e-4, 1.5e-4)
    found = smooth_positions(measured, FORCE, np.zeros(70, dtype=np.int64), PHASE)
    assert np.sqrt(((found - true) ** 2).mean()) < 0.25 * 1.5e-4
    assert np.ptp(found[:, 1]) > 2e-4


def test_exact_positions_stay_exact():
    true, _ = pressed(0.0, 0.0)
    row = np.repeat([0, 1], 35)
    np.testing.assert_allclose(smooth_positions(true, FORCE, row, PHASE), true, atol=1e-12)


def test_sliding_press_is_unchanged():
    _, measured = pressed(0.0, 2e-5)
    measured[:, 1] += np.linspace(0.0, 2e-3, 70)
    found = smooth_positions(measured, FORCE, np.zeros(70, dtype=np.int64), PHASE)
    np.testing.assert_array_equal(found, measured)


def test_rest_short_presses_and_unknown_positions_are_unchanged():
    _, measured = pressed(0.0, 1e-4)
    row = np.full(70, -1)
    row[:4] = 0
    row[10:40] = 1
    measured[12] = np.nan
    found = smooth_positions(measured, FORCE, row, PHASE)
    np.testing.assert_array_equal(found[:10], measured[:10])
    np.testing.assert_array_equal(found[40:], measured[40:])
    assert np.isnan(found[12]).all()
    assert np.ptp(found[13:40, 0]) < 0.5 * np.ptp(measured[13:40, 0])


def test_presses_do_not_mix():
    first, second = pressed(0.0, 1e-4, 1)[1], pressed(0.0, 1e-4, 2)[1] + 5e-3
    both = np.empty((140, 3))
    both[::2], both[1::2] = first, second
    row = np.tile([0, 1], 70)
    found = smooth_positions(both, np.repeat(FORCE, 2), row, np.repeat(PHASE, 2))
    np.testing.assert_allclose(
        found[1::2].mean(axis=0) - found[::2].mean(axis=0), second.mean(0) - first.mean(0)
    )


def test_unloading_has_its_own_path():
    true, measured = pressed(0.0, 1e-4)
    back = np.where(PHASE == UNLOAD, 3.0 - FORCE, 0.0)[:, None] * np.array([0.0, 1.5e-4, 0.0])
    found = smooth_positions(measured + back, FORCE, np.zeros(70, dtype=np.int64), PHASE)
    unloading = PHASE == UNLOAD
    assert np.abs(found - true - back)[unloading, 1].max() < 1.2e-4
    assert found[-1, 1] - found[0, 1] > 0.7 * back.max()


def test_noise_does_not_bend_the_path():
    row = np.zeros(70, dtype=np.int64)
    share = FORCE / FORCE.max()
    columns = np.stack([np.ones(70), share], axis=1)
    bent = 0
    for seed in range(100):
        measured = pressed(0.0, 1e-4, seed)[1]
        line = columns @ np.linalg.lstsq(columns, measured, rcond=None)[0]
        bent += not np.allclose(smooth_positions(measured, FORCE, row, PHASE), line, atol=1e-12)
    assert bent <= 2


@pytest.mark.parametrize("axes", [1, 2])
def test_noise_along_a_surface_does_not_bend_the_path(axes: int):
    row = np.zeros(70, dtype=np.int64)
    share = FORCE / FORCE.max()
    columns = np.stack([np.ones(70), share], axis=1)
    bent = 0
    for seed in range(200):
        noise = 1e-4 * np.random.default_rng(seed).standard_normal((70, axes))
        measured = pressed(0.0, 0.0)[0]
        measured[:, :axes] += noise
        line = columns @ np.linalg.lstsq(columns, measured, rcond=None)[0]
        bent += not np.allclose(smooth_positions(measured, FORCE, row, PHASE), line, atol=1e-12)
    assert bent <= 3
