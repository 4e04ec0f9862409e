"""The scale of each taxel under uniform pressure: found, whatever a level does meanwhile."""

from __future__ import annotations

import numpy as np
import pytest

from skincal.fitting.uniform_scales import bootstrap_common_scale, fit_scales

TRUTH = np.array([1.0, 1.5, 2.0, 0.7])


def answers(seed: int = 0, presses: int = 20) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    load = np.linspace(2.0, 25.0, presses)[:, None] * np.ones(4)
    values = TRUTH * load + 0.3 * np.random.default_rng(seed).standard_normal(load.shape)
    return load, values, np.ones(load.shape, dtype=bool)


def test_scales_are_found_within_their_errors():
    off = []
    for seed in range(40):
        found = fit_scales(*answers(seed), least_counts=5.0)
        off.append((found.scale_per_n - TRUTH) / found.sigma_per_n)
        assert found.responding.all()
    assert np.std(off) == pytest.approx(1.0, abs=0.3)
    assert abs(np.mean(off)) < 0.3


def test_neither_the_zero_of_a_gauge_nor_a_jump_is_a_scale():
    load, values, use = answers()
    values = values - 3.0
    values[1:, 2] += 20.0
    values[7, 0] = 200.0
    found = fit_scales(load, values, use, 5.0)
    assert found.scale_per_n == pytest.approx(TRUTH, rel=0.03)
    assert found.offset_counts[[0, 1, 3]] == pytest.approx(-3.0, abs=0.6)
    assert found.offset_counts[2] == pytest.approx(17.0, abs=0.8)


def test_a_taxel_that_does_not_answer_tells_nothing():
    load, values, use = answers()
    values[:, 1] = 0.2
    use[:, 3] = False
    found = fit_scales(load, values, use, 5.0)
    assert found.responding.tolist() == [True, False, True, False]
    assert found.scale_per_n[[1, 3]].tolist() == [0.0, 0.0]
    assert np.isnan(found.residual[:, [1, 3]]).all()
    assert found.common_per_n == pytest.approx(1.5, rel=0.02)


def test_two_presses_make_lines_through_the_origin():
    load, values, use = answers(presses=2)
    found = fit_scales(load, values, use, 0.5)
    assert found.offset_counts.tolist() == [0.0] * 4
    assert found.scale_per_n == pytest.approx(TRUTH, rel=0.05)


def test_draws_are_about_the_common_scale():
    load, values, use = answers()
    draws = bootstrap_common_scale(load, values, use, 5.0, 50, np.random.default_rng(0))
    middle = fit_scales(load, values, use, 5.0).common_per_n
    assert draws.min() <= middle <= draws.max()
    assert draws.std() < 0.05
