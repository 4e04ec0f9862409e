"""The page on environments names what there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from making import make

import skincal.envs
from skincal.envs.observations import KINDS
from skincal.envs.rewards import RewardScales

PAGE = (Path(__file__).parents[2] / "docs" / "environments.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", skincal.envs.ENVIRONMENTS)
def test_the_page_names_every_part_of_what_is_seen(name: str) -> None:
    env = make(name)
    _, info = env.reset(seed=0)
    parts = [part.name for part in env._observation.critic.parts]
    rows = re.findall(r"^\| (`.*?`) \| ([0-9, ]+)", PAGE.split('`observation["critic"]`')[1], re.M)
    named = [word for row in rows for word in re.findall(r"`(\w+)`", row[0])]
    assert named[: len(parts)] == parts
    assert f"| draws | {sum(part.size for part in env._observation._constant.parts)} |" in PAGE
    terms = (
        info["reward_terms"]
        if info["reward_terms"]
        else env.step(env.action_space.sample())[-1]["reward_terms"]
    )
    assert all(f"| `{term}` |" in PAGE for term in terms)
    assert all(f"`{key}`" in PAGE for key in info)


def test_the_page_tells_how_many_numbers_each_policy_sees() -> None:
    for kind in KINDS:
        sizes = [
            make(name, policy=kind).observation_space["policy"].shape[0] for name in skincal.envs.ENVIRONMENTS
        ]
        assert re.search(rf"^\| `{kind}` \|.*\| {sizes[0]}, {sizes[1]} \|$", PAGE, re.M)


def test_the_page_tells_the_weights_of_the_reward() -> None:
    scales = RewardScales()
    for name in ("position", "force", "grasp", "angle", "joint", "speed", "torque"):
        row = re.search(rf"^\| `{name}` \| (.*) \|$", PAGE, re.M)
        assert row and f"{getattr(scales, name):g}" in row[1]
