"""Shapes and terms of the reward against the paper's."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skincal.envs.rewards import RewardScales, falling, penalty, reward_terms
from skincal.errors import InputError

GOOD: dict[str, Any] = {
    "distance_m": 0.0, "force_n": 1.5, "right_contact": True,
    "past_joint_rad": -1.0, "past_speed": -1.0, "past_torque": -1.0,
}  # fmt: skip


def test_shape_of_a_reward_term() -> None:
    assert [falling(x, 2.0) for x in (-1.0, 0.0, 1.0, 2.0, 5.0)] == pytest.approx([1, 1, 0.5, 0, 0])
    assert falling(0.5, 2.0) == pytest.approx(0.5 * (1 + math.cos(math.pi / 4)))


@given(st.floats(-1, 3), st.floats(-1, 3))
def test_more_deviation_never_pays(a: float, b: float) -> None:
    low, high = sorted((a, b))
    assert 0.0 <= falling(high, 2.0) <= falling(low, 2.0) <= 1.0
    assert penalty(low, 2.0) == pytest.approx(1 - falling(low, 2.0))


def test_best_step_pays_the_sum_of_the_published_weights() -> None:
    assert sum(reward_terms(RewardScales(), **GOOD).values()) == pytest.approx(0.15 + 0.05 + 0.05)
    bolt = reward_terms(RewardScales(), **GOOD, angle_rad=0.0)
    assert sum(bolt.values()) == pytest.approx(0.15 + 0.05 + 0.05 + 0.05)


@pytest.mark.parametrize(
    ("change", "term", "value"),
    [
        ({"distance_m": 2.5e-3}, "position", 0.075),
        ({"distance_m": 5e-3}, "position", 0.0),
        ({"distance_m": math.inf}, "position", 0.0),
        ({"force_n": 0.75}, "force", 0.025),
        ({"force_n": 2.25}, "force", 0.025),
        ({"force_n": 3.0}, "force", 0.0),
        ({"right_contact": False}, "grasp", 0.0),
        ({"angle_rad": math.radians(7.5)}, "angle", 0.025),
        ({"angle_rad": math.radians(-15)}, "angle", 0.0),
        ({"past_joint_rad": math.radians(2.5)}, "joint", -0.005),
        ({"past_joint_rad": 1.0}, "joint", -0.01),
        ({"past_speed": 0.1}, "speed", -0.005),
        ({"past_torque": 0.2}, "torque", -0.01),
    ],
)
def test_each_term_has_its_width(change: dict[str, float], term: str, value: float) -> None:
    terms = reward_terms(RewardScales(), **{**GOOD, **change})
    assert terms[term] == pytest.approx(value, abs=1e-12)


def test_a_weight_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match=r"RewardScales\.force: expected a finite number, 0 or more"):
        RewardScales(force=-0.1)
