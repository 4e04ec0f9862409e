"""The tasks as Gymnasium wants them."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import skincal.envs  # noqa: F401  # registers the tasks


@pytest.mark.parametrize(
    ("name", "policy"),
    [
        ("skincal/MarbleRoll-v0", "tactile"),
        ("skincal/BoltRoll-v0", "tactile"),
        ("skincal/MarbleRoll-v0", "joint-angles"),
        pytest.param("skincal/MarbleRoll-v0", "desired", marks=pytest.mark.slow),
        pytest.param("skincal/BoltRoll-v0", "joint-angles", marks=pytest.mark.slow),
        pytest.param("skincal/BoltRoll-v0", "desired", marks=pytest.mark.slow),
    ],
)
def test_gymnasium_finds_nothing_to_say(name: str, policy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    env: Any = gymnasium.make(name, policy=policy)
    check_env(env.unwrapped)
    env.close()


@pytest.mark.parametrize(
    ("policy", "size"), [("tactile", 5 * 22 + 4), ("joint-angles", 5 * 18 + 4), ("desired", 34)]
)
def test_each_policy_sees_what_the_paper_gives_it(policy: str, size: int) -> None:
    env: Any = gymnasium.make("skincal/MarbleRoll-v0", policy=policy)
    assert env.observation_space["policy"].shape == (size,)
    assert env.action_space == gymnasium.spaces.Box(-1, 1, (6,), np.float32)


def test_a_pickle_makes_the_same_environment() -> None:
    env: Any = gymnasium.make("skincal/MarbleRoll-v0", policy="joint-angles", box_half_m=0.004)
    copy = pickle.loads(pickle.dumps(env.unwrapped))
    assert copy.options == env.unwrapped.options
    first, again = env.reset(seed=3)[0], copy.reset(seed=3)[0]
    assert all(np.array_equal(first[name], again[name]) for name in first)
    env.close()
    copy.close()
