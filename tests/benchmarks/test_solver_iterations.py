"""Cost of the contact solver's iterations; the table marks the defaults."""

from __future__ import annotations

from benchmarks.solver_iterations import COUNTS, apart, episodes
from skincal.envs import BoltRollEnv, MarbleRollEnv

MARBLE = "skincal/MarbleRoll-v0"


def test_solver_iterations_are_compared_on_equal_episodes() -> None:
    some, seconds = episodes(MARBLE, 20, 2, 4)
    again, _ = episodes(MARBLE, 20, 2, 4)
    others, _ = episodes(MARBLE, 5, 2, 4)
    assert seconds > 0 and [len(one) for one in some] == [4, 4]
    assert [apart(a, b) for a, b in zip(some, again, strict=True)] == [(0.0, 0.0)] * 2
    assert all(min(apart(a, b)) > 0 for a, b in zip(some, others, strict=True))


def test_the_defaults_are_in_the_table() -> None:
    for task in (MarbleRollEnv, BoltRollEnv):
        assert task.default_options().solver_iterations in COUNTS
