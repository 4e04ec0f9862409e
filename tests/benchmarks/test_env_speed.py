"""The benchmarks of the environments run, and what they find is sound."""

from __future__ import annotations

import pytest

from benchmarks.env_speed import PAPER_REAL_TIME, one
from benchmarks.env_stress import WAYS, stress

MARBLE, BOLT = "skincal/MarbleRoll-v0", "skincal/BoltRoll-v0"


def test_an_environment_is_faster_than_that_of_the_paper() -> None:
    found = one(MARBLE, "tactile", 60)
    assert found["times_real_time"] > 2 * PAPER_REAL_TIME
    assert 0.0 < found["skin_share"] < 0.5


def test_every_way_of_acting_is_taken_and_none_breaks_a_task() -> None:
    found = stress(MARBLE, "desired", 100, seed=0, duration_s=1.5)
    assert found["episodes"] >= len(WAYS)
    assert found["sound"] and found["not_finite"] == 0 and found["outside_the_space"] == 0
    assert 0.0 < found["largest_force_n"] < 60.0


@pytest.mark.slow
def test_a_marble_rolls_twenty_times_as_fast_as_in_life() -> None:
    found = one(MARBLE, "tactile", 900)
    assert found["times_real_time"] >= 20
    assert found["skin_share"] < 0.12


@pytest.mark.slow
@pytest.mark.parametrize("name", [MARBLE, BOLT])
def test_extreme_actions_for_long(name: str) -> None:
    assert stress(name, "tactile", 4000, seed=1)["sound"]
