from __future__ import annotations

import numpy as np
import pytest

from skincal.model.rest import levels_from_presses, rest_from_presses


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


@pytest.mark.parametrize(("integer", "sigma"), [(False, 1.0), (False, 5.0), (True, 5.0)])
def test_half_of_the_noise_is_clipped(integer: bool, sigma: float) -> None:
    """Single frames that rest on the converter's bound: the readings above it tell what was cut off."""
    rng = np.random.default_rng(3)
    counts = sigma * rng.standard_normal((60, 12))
    lit = rng.random((60, 12)) < 0.25
    counts[lit] += rng.uniform(5 * sigma, 200.0, lit.sum())
    found = levels_from_presses(np.clip(np.rint(counts) if integer else counts, 0, None))
    assert found.scatter == pytest.approx(0.58 * sigma, rel=0.25)
    assert found.level == pytest.approx(np.full(12, 0.4 * sigma), abs=0.35 * sigma)


def test_signals_next_to_a_bound_are_no_noise() -> None:
    rng = np.random.default_rng(4)
    counts = np.where(rng.random((60, 12)) < 0.35, rng.uniform(0, 200, (60, 12)), 0.0)
    assert levels_from_presses(counts).scatter < 0.5
