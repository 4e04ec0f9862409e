"""Whole episodes: how they begin, go on and end; the tasks as Gymnasium wants them."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from making import BOLT, MARBLE, make, rolling

import skincal.envs

STILL = np.zeros(6)


def history(env: Any, seed: int, actions: np.ndarray) -> np.ndarray:
    """All that an episode says, as one array."""
    observation, _ = env.reset(seed=seed)
    parts = [observation["policy"], observation["critic"]]
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        parts += [observation["policy"], observation["critic"], np.array([reward])]
        if terminated or truncated:
            break
    return np.concatenate(parts)


@pytest.mark.parametrize("name", [MARBLE, BOLT])
def test_a_seed_gives_the_same_episode_to_the_last_bit(name: str) -> None:
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (6, 6))
    first, second = make(name), make(name)
    expected = history(first, 5, actions)
    history(second, 1, -actions)
    assert np.array_equal(history(second, 5, actions), expected)
    assert np.array_equal(history(first, 5, actions), expected)
    assert not np.array_equal(history(first, 6, actions)[: len(expected)], expected)


def test_environments_of_one_process_do_not_disturb_each_other() -> None:
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (8, 6))
    alone, one, other = make(), make(), make(BOLT)
    alone.reset(seed=3)
    expected = [alone.step(action)[0]["critic"] for action in actions]
    one.reset(seed=3), other.reset(seed=4)
    for action, critic in zip(actions, expected, strict=True):
        assert np.array_equal(one.step(action)[0]["critic"], critic)
        other.step(-action)
    one.reset(seed=3)
    assert np.array_equal(one.step(actions[0])[0]["critic"], expected[0])


@pytest.mark.parametrize("name", [MARBLE, BOLT])
def test_an_episode_begins_near_the_best_grasp_force(name: str) -> None:
    env = make(name, policy="desired")
    infos = [env.reset(seed=seed)[1] for seed in range(8)]
    forces = np.array([info["force_n"] for info in infos])
    assert not any(info["held"] or info["drop"] for info in infos)
    assert abs(forces.mean() - 1.5) < 0.25 and forces.min() > 0.8 and forces.max() < 2.4


def test_the_error_at_first_is_that_of_the_paper() -> None:
    env = make(policy="desired")
    asked = {"trajectory": "circle", "randomize": skincal.envs.JOINT_OFFSETS}
    errors = [env.reset(seed=seed, options=asked)[1]["error_m"] for seed in range(16)]
    # The paper: 1.5 mm.
    assert 0.8e-3 < np.mean(errors) < 2.2e-3


def test_an_unreached_object_is_not_dropped() -> None:
    env = make(policy="desired")
    env.reset(seed=0, options={"randomize": "none", "values": {"object.marble.position_m": [0, 0, 0.05]}})
    *_, terminated, _, info = env.step(STILL)
    assert info["held"] and not info["drop"] and not terminated


def test_an_action_changes_angles_within_the_limits() -> None:
    env = make(policy="desired", speed_rad_per_s=0.5)
    observation, _ = env.reset(seed=0)
    newest = slice(24, 30)
    before = observation["policy"][newest]
    after = env.step(np.array([1.0, -1.0, 0.5, 0.0, 7.0, np.nan]))[0]["policy"]
    assert after[newest] - before == pytest.approx([0.05, -0.05, 0.025, 0.0, 0.05, 0.0], abs=1e-6)
    # What was seen moves one place back in the stack.
    assert np.array_equal(after[18:24], before)
    upper = env.pinch.description.limits.upper_rad
    for _ in range(60):
        observation, _, terminated, truncated, _ = env.step(np.ones(6))
        if terminated or truncated:
            break
    assert np.all(observation["policy"][newest] <= upper + 1e-6)


def test_what_each_policy_sees_of_the_joints() -> None:
    env = make(policy="joint-angles")
    observation, info = env.reset(seed=1)
    desired, measured, error = np.split(observation["policy"][72:90], 3)
    motor = np.array(env.world.scene.drives.motor_rad)
    offset, noise = info["randomized"]["finger.joint_offset_rad"], info["noise"]["finger.joint_noise_rad"]
    assert measured == pytest.approx(motor + offset + noise, abs=1e-6)
    assert error == pytest.approx(desired - measured, abs=1e-6)
    assert np.any(offset != 0) and np.any(noise != 0)


def test_the_policy_sees_the_present_target_and_how_it_moved() -> None:
    env = make(policy="desired")
    env.reset(seed=0, options={"trajectory": "circle"})
    for k in range(1, 4):
        observation, *_, info = env.step(STILL)
        assert observation["policy"][-4:] == pytest.approx([k * 2.5e-4, 0, 2.5e-4, 0], abs=1e-8)
        assert info["target_m"] == pytest.approx([k * 2.5e-4, 0])
        assert info["error_m"] == pytest.approx(np.linalg.norm(info["target_m"] - info["position_m"]))
        assert info["time_s"] == pytest.approx(k / 10)


def test_fingers_that_open_drop_the_object_and_end_the_episode() -> None:
    env = make(policy="desired")
    env.reset(seed=0)
    for _ in range(60):
        _, reward, terminated, truncated, info = env.step(np.array([0.0, -1.0, -1.0, 0.0, -1.0, -1.0]))
        if terminated:
            break
    assert info["time_s"] < 3 and terminated and not truncated
    assert info["drop"] and not info["success"]
    assert info["reward_terms"]["grasp"] == 0 and reward < 0.01


@pytest.mark.parametrize(
    ("options", "steps"), [({}, 60), ({"duration_s": 1.0}, 10), ({"trajectory": "circle"}, 80)]
)
def test_the_time_out_truncates(options: dict[str, Any], steps: int) -> None:
    env = make(policy="desired")
    env.reset(seed=0, options={**options, "randomize": "none"})
    for _ in range(99):
        *_, terminated, truncated, info = env.step(STILL)
        if truncated:
            break
    assert round(10 * info["time_s"]) == steps and not terminated and info["success"] and not info["drop"]


def test_a_marble_can_be_rolled_round_the_circle() -> None:
    env = make(policy="desired")
    env.reset(seed=0, options={"trajectory": "circle"})
    errors, truncated = [], False
    while not truncated:
        target = env._targets[env._step + 1]
        *_, terminated, truncated, info = env.step(rolling(env, target))
        assert not terminated
        errors.append(info["error_m"])
        assert info["reward_terms"]["grasp"] == pytest.approx(0.05)
    assert np.mean(errors[20:]) < 0.5e-3


@pytest.mark.parametrize("orientation_deg", skincal.envs.ORIENTATIONS_DEG)
def test_a_bolt_can_be_rolled_along_its_normal(orientation_deg: float) -> None:
    env = make(BOLT, policy="desired")
    env.reset(seed=0, options={"orientation_deg": orientation_deg, "frequency_hz": 0.4, "duration_s": 2.5})
    rolled, targets, truncated = [], [], False
    while not truncated:
        here = env.truth.position_m
        goal = env._targets[env._step + 1, 0] * env._normal
        along = here + ((goal - here) @ env._normal) * env._normal
        *_, terminated, truncated, info = env.step(rolling(env, along))
        assert not terminated
        rolled.append(info["rolled_m"]), targets.append(info["rolled_target_m"])
        assert abs(info["orientation_error_rad"]) < np.radians(15)
    assert np.corrcoef(rolled, targets)[0, 1] > 0.95


@pytest.mark.parametrize("name", [MARBLE, BOLT])
def test_extreme_actions_stay_within_physics(name: str) -> None:
    env = make(name)
    rng, force = np.random.default_rng(0), 0.0
    acts = (
        lambda: rng.choice([-1.0, 1.0], 6),
        lambda: np.array([0.0, 1.0, 1.0, 0.0, 1.0, 1.0]),
        lambda: rng.choice([np.nan, np.inf, -np.inf, 1e9], 6),
    )
    for seed, act in enumerate(acts):
        env.reset(seed=seed)
        ended = False
        while not ended:
            observation, reward, terminated, truncated, info = env.step(act())
            ended = terminated or truncated
            assert env.observation_space.contains(observation) and np.isfinite(reward)
            force = max(force, info["force_n"])
    assert 2.0 < force < 60.0


@pytest.mark.parametrize("angle_rad", [np.nan, np.inf, 1e5])
def test_a_world_that_has_gone_astray_ends_the_episode(
    monkeypatch: pytest.MonkeyPatch, angle_rad: float
) -> None:
    env = make()
    env.reset(seed=0)
    astray = (np.full(6, angle_rad), np.zeros(6))
    monkeypatch.setattr(env.world.scene, "joints", lambda: astray)
    observation, reward, terminated, truncated, info = env.step(STILL)
    assert terminated and not truncated and info["drop"]
    assert env.observation_space.contains(observation) and np.isfinite(reward)


@pytest.mark.parametrize("name", [MARBLE, BOLT])
def test_more_iterations_of_the_solver_change_little(name: str) -> None:
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, (10, 6))
    places = []
    for iterations in (20, 200):
        env = make(name, policy="desired", solver_iterations=iterations)
        env.reset(seed=0)
        places.append([env.step(action)[4]["position_m"] for action in actions])
    apart = np.abs(np.subtract(*places)).max()
    assert 0 < apart < 0.5e-3


def test_a_step_before_the_first_reset_is_refused() -> None:
    with pytest.raises(gymnasium.error.ResetNeeded):
        make().step(STILL)


@pytest.mark.parametrize(
    ("name", "policy"),
    [
        (MARBLE, "tactile"),
        (BOLT, "tactile"),
        (MARBLE, "joint-angles"),
        pytest.param(MARBLE, "desired", marks=pytest.mark.slow),
        pytest.param(BOLT, "joint-angles", marks=pytest.mark.slow),
        pytest.param(BOLT, "desired", marks=pytest.mark.slow),
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
    env: Any = gymnasium.make(MARBLE, policy=policy)
    assert env.observation_space["policy"].shape == (size,)
    assert env.action_space == gymnasium.spaces.Box(-1, 1, (6,), np.float32)


def test_a_pickle_makes_the_same_environment() -> None:
    env: Any = gymnasium.make(MARBLE, policy="joint-angles", box_half_m=0.004)
    copy = pickle.loads(pickle.dumps(env.unwrapped))
    assert copy.options == env.unwrapped.options
    first, again = env.reset(seed=3)[0], copy.reset(seed=3)[0]
    assert all(np.array_equal(first[name], again[name]) for name in first)
    env.close()
    copy.close()
