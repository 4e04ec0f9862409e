"""Evaluations: the same runs for all policies, and what they come to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="needs skincal[policy]")

import gymnasium
import toy_task

from skincal.train import Description, PolicyKind, Task
from skincal.train.evaluate import Trial, episode, evaluate
from skincal.train.scores import score


@dataclass
class Actor:
    """Acts like a policy that was read from a file."""

    act: Callable[[np.ndarray], np.ndarray]
    size: int = 2 * toy_task.STACK
    file: str = "toy.onnx"

    @property
    def description(self) -> Description:
        part: dict[str, Any] = {"name": "policy", "size": self.size}
        return Description(Task.marble, PolicyKind.tactile, (part,), 2, "", 0, 0, 0.0, "sb3")

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        return self.act(observation)


GOOD = Actor(lambda seen: np.clip(seen[-2:] / 0.3, -1, 1).astype(np.float32))
AWAY = Actor(lambda seen: -np.sign(seen[-2:]).astype(np.float32))
STILL = Actor(lambda seen: np.zeros(2, np.float32))
TRIAL = Trial(Task.marble, episodes=4, seed=7)


@pytest.fixture
def toy():
    toy_task.register()
    environment = gymnasium.make(toy_task.ID)
    yield environment
    environment.close()


def test_a_good_policy_scores_well(toy):
    good, still = (score(evaluate(a, toy, TRIAL), np.random.default_rng(1)) for a in (GOOD, STILL))
    assert good.error_settled_m < 0.3e-3 < still.error_settled_m
    assert (good.drops, good.episodes, len(good.time_s)) == (0, 4, 80)
    assert good.time_s[0] == pytest.approx(0.1)
    assert good.time_s[-1] == pytest.approx(8.0)


def test_all_policies_have_the_same_runs(toy):
    first, again, other = evaluate(GOOD, toy, TRIAL), evaluate(GOOD, toy, TRIAL), evaluate(STILL, toy, TRIAL)
    np.testing.assert_array_equal(first.error_m, again.error_m)
    np.testing.assert_array_equal(first.target_m, other.target_m)
    assert not np.array_equal(first.target_m[0], first.target_m[1])
    elsewhere = evaluate(GOOD, toy, Trial(Task.marble, episodes=4, seed=8))
    assert not np.array_equal(first.target_m, elsewhere.target_m)


def test_a_lost_object_ends_a_run(toy):
    runs = evaluate(AWAY, toy, TRIAL)
    assert runs.dropped.all()
    assert np.isnan(runs.error_m[:, -1]).all()
    assert np.isfinite(runs.error_m[:, 0]).all()
    ended = np.isnan(runs.error_m).argmax(axis=1)
    # In the step that loses the object the target is still known, the object's place is not.
    assert np.isfinite(runs.target_m[np.arange(4), ended]).all()
    assert np.isnan(runs.object_m[np.arange(4), ended]).all()


def test_episodes_begin_as_published():
    assert TRIAL.options(0) == {
        "duration_s": 8.0, "randomize": ["finger.joint_offset_rad"], "values": {}, "trajectory": "circle",
    }  # fmt: skip
    bolt = Trial(Task.bolt, episodes=8)
    assert [bolt.options(i)["orientation_deg"] for i in range(5)] == [-45.0, 0.0, 45.0, 90.0, -45.0]
    assert bolt.steps == 240
    assert Trial(Task.bolt, randomize=None).options(0)["randomize"] == "all"


def test_an_episode_step_by_step(toy):
    steps = list(episode(GOOD, toy, TRIAL, 0))
    assert len(steps) == 80
    assert [step.over for step in steps] == [False] * 79 + [True]
