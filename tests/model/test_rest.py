from __future__ import annotations

import numpy as np
import pytest

from skincal.model.rest import rest_from_presses


def test_presses_that_touch_a_taxel_do_not_lift_its_level() -> None:
    rng = np.random.default_rng(0)
    counts = 0.4 + 0.1 * rng.standard_normal((60, 8))
    counts[rng.random((60, 8)) < 0.2] += 40.0
    rest, scatter = rest_from_presses(counts)
    assert rest == pytest.approx(np.full(8, 0.4), abs=0.06)
    assert scatter == pytest.approx(0.1, abs=0.03)


def test_an_always_touched_taxel_gets_the_common_level() -> None:
    rng = np.random.default_rng(1)
    counts = 0.4 + 0.1 * rng.standard_normal((30, 6))
    counts[:, 2] = rng.uniform(20, 90, 30)
    assert rest_from_presses(counts)[0][2] == pytest.approx(0.4, abs=0.1)


def test_a_taxel_with_an_offset_keeps_it_and_a_dead_one_has_none() -> None:
    rng = np.random.default_rng(2)
    counts = 0.4 + 0.1 * rng.standard_normal((30, 4))
    counts[:, 1] += 7.0
    counts[:, 3] = np.nan
    rest, _ = rest_from_presses(counts)
    assert rest[1] == pytest.approx(7.4, abs=0.1)
    assert np.isnan(rest[3])
    assert np.isnan(rest_from_presses(counts[:, 3:])[1])
