"""The tasks as Gymnasium wants them."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env


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
