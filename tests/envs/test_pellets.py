"""Pellets between two fingertips: how many are held, what pays, what is felt."""

from __future__ import annotations

import numpy as np
import pytest
from making import PELLETS, make

from skincal.effects import EFFECTS
from skincal.envs.observations import KINDS
from skincal.errors import InputError
from skincal.ranges import Parameter, preset


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_two_at_least_are_taken_and_held(engine: str) -> None:
    if engine == "mujoco":
        pytest.importorskip("mujoco", reason="needs skincal[mujoco]")
    env = make(PELLETS, engine=engine, policy="desired")
    for seed in range(4):
        _, info = env.reset(seed=seed, options={"randomize": "none"})
        assert info["pellets_held"] == info["pellets_target"] >= 2
        *_, info = env.step(np.zeros(6))
        assert info["pellets_held"] == info["pellets_target"] and info["error_m"] == 0
        assert info["reward_terms"]["position"] == env.options.rewards.position


def test_one_less_is_asked_for_after_each_part_until_one_is_left() -> None:
    env = make(PELLETS, policy="desired")
    env.reset(seed=1, options={"pellets": 2, "randomize": "none"})
    asked = env._targets[:61, 0]
    assert asked[0] == 2 and asked[29] == 2 and asked[30] == 1 and asked[60] == 1


def test_letting_go_of_all_ends_the_episode() -> None:
    env = make(PELLETS, policy="desired")
    env.reset(seed=1, options={"pellets": 2, "randomize": "none"})
    open_hand = env.world.grasp.postures.at(0.03) - env._desired
    ended, steps = False, 0
    while not ended:
        *_, ended, late, info = env.step(np.clip(open_hand / 0.03, -1, 1))
        steps += 1
        assert not late
    assert info["drop"] and not info["success"] and info["pellets_held"] < 2 and steps < 30


def test_the_skin_feels_each_pellet() -> None:
    quiet = {"skin.taxel_noise_counts": 0.0, "skin.taxel_offset_counts": 0.0}
    env = make(PELLETS, policy="tactile")
    env.reset(seed=1, options={"pellets": 2, "randomize": "none", "values": quiet})
    env.step(np.zeros(6))
    felt = env.skin_contact()
    assert felt is not None and len(felt.contacts.force_n) == 2
    one = env.skin._skin.values(env.world.body.indenter, felt.contacts)
    together = env.skin._values(felt, 0.1)
    np.testing.assert_allclose(together, one.sum(axis=0))
    assert (one.max(axis=1) > 0).all()


@pytest.mark.parametrize("policy", list(KINDS))
def test_every_sensor_fits_its_space(policy: str) -> None:
    env = make(PELLETS, policy=policy)
    observation, _ = env.reset(seed=2)
    assert env.observation_space.contains(observation)
    observation, *_ = env.step(env.action_space.sample())
    assert env.observation_space.contains(observation)


def test_effects_are_refused() -> None:
    name = next(name for name, effect in EFFECTS.items() if not effect.of_rig and effect.parameters)
    path = f"skin.effects.{name}.{EFFECTS[name].parameters[0].name}"
    ranges = preset("icra26").replace({path: Parameter.constant(EFFECTS[name].parameters[0].neutral)})
    with pytest.raises(InputError, match="no effects, for pellets"):
        make(PELLETS, ranges=ranges)
