from __future__ import annotations

import numpy as np
import pytest

from skincal.model import Converter


def test_rounds_and_clips_as_the_papers_sensor():
    np.testing.assert_array_equal(
        Converter().apply([-3.0, 0.4, 0.6, 1.5, 2.5, 254.7, 300.0]), [0, 0, 1, 2, 2, 255, 255]
    )


def test_an_absent_end_does_not_clip():
    np.testing.assert_array_equal(Converter(value_min=None).apply([-3.2, 300]), [-3, 255])
    np.testing.assert_array_equal(Converter(value_max=None).apply([-3.2, 300.2]), [0, 300])


def test_none_changes_nothing():
    values = np.array([[-1.25, np.nan, np.inf]])
    np.testing.assert_array_equal(Converter.none().apply(values), values)


def test_nan_stays_and_the_input_is_not_touched():
    values = np.array([0.4, np.nan])
    np.testing.assert_array_equal(Converter().apply(values), [0.0, np.nan])
    assert values[0] == 0.4


@pytest.mark.parametrize(("low", "high"), [(255, 0), (1, 1), (np.nan, 255)])
def test_a_range_that_is_none_is_refused(low, high):
    with pytest.raises(ValueError, match="value_min < value_max"):
        Converter(value_min=low, value_max=high)
