from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skincal.model import solve_penetration

GAPS = arrays(np.float64, st.tuples(st.integers(1, 4), st.integers(1, 30)), elements=st.floats(0, 5e-3))


@settings(max_examples=200)
@given(GAPS, st.integers(0, 2**32 - 1), st.floats(1e-14, 1e-6))
def test_the_stresses_carry_the_load(gap, seed, load):
    weight = np.random.default_rng(seed).uniform(1e-9, 1e-7, gap.shape)
    depth = solve_penetration(gap, weight, np.full(len(gap), load))
    carried = np.sum(weight * np.maximum(depth[:, None] - gap, 0.0), axis=1)
    # The depth is rounded to 1e-16 of itself, which an area of up to 3e-6 m² turns into load.
    np.testing.assert_allclose(carried, load, rtol=1e-12, atol=4e-16 * 3e-6 * depth.max())


def test_one_linear_piece_is_solved_by_hand():
    # p - 0 over 2 cells and p - 1 mm over 1 cell of 1 mm²: 3 p - 1 mm = 5 mm.
    depth = solve_penetration([[0.0, 0.0, 1e-3]], np.full(3, 1e-6), [5e-9])
    assert depth[0] == pytest.approx(2e-3, rel=1e-15)


def test_a_constant_in_the_distances_only_moves_the_level():
    gap = np.random.default_rng(0).uniform(0, 1e-3, (3, 40))
    weight, load = np.full(40, 1e-8), np.array([1e-11, 1e-10, 1e-9])
    np.testing.assert_allclose(
        solve_penetration(gap - 0.02, weight, load), solve_penetration(gap, weight, load) - 0.02, rtol=1e-12
    )


def test_zero_and_negative_load_is_first_touch():
    gap = np.array([[2e-4, 1e-4, 0.0], [3e-4, 1e-4, 0.0]])
    weight = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0]])
    np.testing.assert_array_equal(solve_penetration(gap, weight, [0.0, -1.0]), [0.0, 1e-4])


def test_loads_that_are_not_finite_give_nan():
    gap = np.zeros((4, 2))
    depth = solve_penetration(gap, np.ones(2), [np.nan, np.inf, -np.inf, 1.0])
    np.testing.assert_array_equal(depth, [np.nan, np.nan, np.nan, 0.5])


def test_points_that_cannot_be_touched_do_not_count():
    gap = [[0.0, np.inf, 1e-4, -1.0]]
    weight = [[1e-8, 1e-8, 1e-8, 0.0]]
    np.testing.assert_allclose(
        solve_penetration(gap, weight, [1e-11]), solve_penetration([[0.0, 1e-4]], [[1e-8, 1e-8]], [1e-11])
    )


@pytest.mark.parametrize("gap", [np.full((2, 3), np.inf), np.zeros((2, 0))])
def test_nothing_to_touch_gives_zero(gap):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(solve_penetration(gap, 1.0, [1.0, np.nan]), [0.0, np.nan])


@pytest.mark.parametrize("load", [5e-324, 1e-300, 1e-30, 1e300])
def test_extreme_loads_end(load):
    depth = solve_penetration([[0.0, 1e-3]], np.full(2, 1e-8), [load])
    assert np.isfinite(depth[0])
    assert depth[0] > 0


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"gap_m: expected shape \(2, 'any'\); got \(1, 3\)"):
        solve_penetration(np.zeros((1, 3)), np.ones(3), [1.0, 2.0])
