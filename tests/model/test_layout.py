from __future__ import annotations

import numpy as np
import pytest

from skincal.model import TaxelLayout


def test_the_contracts_order_and_centres():
    layout = TaxelLayout.grid(3, 2, taxel_size_m=0.002, pitch_m=(0.004, 0.005))
    for r in range(3):
        for c in range(2):
            u, v = layout.centres_m[r * 2 + c]
            assert u == pytest.approx((c - 0.5) * 0.004)
            assert v == pytest.approx((r - 1.0) * 0.005)
    assert layout.taxels == 6


def test_bounds_reach_the_outer_edges():
    layout = TaxelLayout.grid(4, 4, taxel_size_m=0.0025, pitch_m=0.004)
    np.testing.assert_allclose(layout.bounds_m, [[-0.00725, -0.00725], [0.00725, 0.00725]])


def test_points_find_their_taxel_and_the_gaps_none():
    layout = TaxelLayout.grid(2, 2, taxel_size_m=(0.002, 0.001), pitch_m=0.004)
    centres, gap = layout.centres_m, [[0.0, 0.0], [0.002, 0.0], [0.02, 0.002]]
    np.testing.assert_array_equal(layout.taxel_at(centres), [0, 1, 2, 3])
    np.testing.assert_array_equal(layout.taxel_at(centres + np.array([0.00099, -0.00049])), [0, 1, 2, 3])
    np.testing.assert_array_equal(layout.taxel_at(centres + np.array([0.0, 0.00051])), [-1] * 4)
    np.testing.assert_array_equal(layout.taxel_at(gap), [-1, -1, -1])


def test_any_positions_and_sizes_can_be_given():
    layout = TaxelLayout(
        1, 2, np.array([[0.0, 0.0], [0.01, 0.003]]), np.array([[0.002, 0.004], [0.006, 0.001]])
    )
    np.testing.assert_array_equal(layout.taxel_at([[0.0, 0.0019], [0.0129, 0.003], [0.0, 0.003]]), [0, 1, -1])


def test_arrays_are_read_only_copies():
    centres = np.array([[0.0, 0.0]])
    layout = TaxelLayout(1, 1, centres, np.array([0.001, 0.001]))
    centres[:] = 1.0
    assert layout.centres_m[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        layout.centres_m[0, 0] = 1.0


@pytest.mark.parametrize(
    ("rows", "cols", "size", "pitch", "message"),
    [
        (0, 4, 0.002, 0.004, "at least one row"),
        (4, 4, 0.005, 0.004, "pitch less than the taxel size"),
        (4, 4, -0.002, 0.004, "lengths > 0"),
        (4, 4, 0.002, np.nan, "finite"),
    ],
)
def test_what_makes_no_sense_is_refused(rows, cols, size, pitch, message):
    with pytest.raises(ValueError, match=message):
        TaxelLayout.grid(rows, cols, taxel_size_m=size, pitch_m=pitch)


def test_taxels_side_by_side_without_gaps_do_not_overlap():
    assert TaxelLayout.grid(28, 10, taxel_size_m=0.005692, pitch_m=0.005692).taxels == 280
