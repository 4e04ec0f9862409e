"""Run policies in the published evaluations and record their episodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from skincal.envs.trajectories import ORIENTATIONS_DEG, POLICY_HZ
from skincal.errors import input_error
from skincal.ranges import Ranges
from skincal.tasks import DURATION_S, ENVIRONMENT_IDS, JOINT_OFFSETS, Task
from skincal.train.policy_file import Policy
from skincal.train.scores import Runs
from skincal.train.settings import part_seed

Environment = gymnasium.Env[Any, Any]


@dataclass(frozen=True)
class Trial:
    """Options of an evaluation.

    Attributes:
        seed: of the episodes: the same ones for all policies.
        duration_s: length of an episode [s]; None: 8 s for the marble, 24 s for the bolt.
        randomize: names of parameters and tables that are drawn, the rest being nominal; None: all.
        values: values by full name that take the place of draws.
        trajectory: of the marble: ``circle``, ``random``, or targets (N, 2) at 10 Hz [m].
    """

    task: Task
    episodes: int = 100
    seed: int = 0
    duration_s: float | None = None
    randomize: Sequence[str] | None = JOINT_OFFSETS
    values: Mapping[str, Any] = field(default_factory=dict[str, Any])
    trajectory: Any = "circle"
    environment: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def steps(self) -> int:
        """Steps of an episode that goes to its end."""
        return round((self.duration_s or DURATION_S[self.task]) * POLICY_HZ)

    def options(self, episode: int) -> dict[str, Any]:
        """Return the initial conditions of an episode."""
        options: dict[str, Any] = {
            "duration_s": self.steps / POLICY_HZ,
            "randomize": "all" if self.randomize is None else list(self.randomize),
            "values": dict(self.values),
        }
        if self.task is Task.marble:
            options["trajectory"] = self.trajectory
        if self.task is Task.bolt:
            options["orientation_deg"] = ORIENTATIONS_DEG[episode % len(ORIENTATIONS_DEG)]
        return options

    def episode_seed(self, episode: int) -> int:
        """Return the seed of an episode."""
        return part_seed(self.seed, episode)


@dataclass(frozen=True, eq=False)
class Step:
    """One step of an episode."""

    observation: Mapping[str, NDArray[np.float32]]
    reward: float
    info: Mapping[str, Any]
    over: bool


def check_task(policy: Policy, task: Task) -> None:
    """Check that a policy was made for a task.

    Raises:
        InputError: it was made for another.
    """
    if policy.description.task != task:
        fix = f"skincal eval {policy.description.task} {policy.file}"
        raise input_error(policy.file, f"a policy for {task}", f"one for {policy.description.task}", fix)


def environment_for(
    policy: Policy, trial: Trial, ranges: Ranges | None = None, **arguments: Any
) -> Environment:
    """Return the environment in which a policy is tried.

    Raises:
        InputError: the policy is of another task, or sees something else than the environment shows.
    """
    import skincal.envs  # noqa: F401  # registers the tasks

    check_task(policy, trial.task)
    kind = str(policy.description.policy)
    given = {**trial.environment, **arguments}
    environment = gymnasium.make(ENVIRONMENT_IDS[trial.task], policy=kind, ranges=ranges, **given)
    check_fits(policy, environment)
    return environment


def check_fits(policy: Policy, environment: Environment) -> None:
    """Check that a policy sees and moves as much as an environment has.

    Raises:
        InputError: it does not.
    """
    space, about = environment.observation_space, policy.description
    assert isinstance(space, gymnasium.spaces.Dict)
    there = (gymnasium.spaces.flatdim(space["policy"]), gymnasium.spaces.flatdim(environment.action_space))
    if (about.size, about.actions) != there:
        expected = f"a policy from {there[0]} observed values to {there[1]} actions"
        raise input_error(policy.file, expected, f"one from {about.size} to {about.actions}")


def episode(policy: Policy, environment: Environment, trial: Trial, number: int) -> Iterator[Step]:
    """Return one episode, step by step."""
    observation, _ = environment.reset(seed=trial.episode_seed(number), options=trial.options(number))
    over = False
    while not over:
        observation, reward, lost, late, info = environment.step(policy(observation["policy"]))
        over = lost or late
        yield Step(observation, float(reward), info, over)


def evaluate(
    policy: Policy,
    environment: Environment,
    trial: Trial,
    *,
    progress: Callable[[int], None] = lambda _: None,
) -> Runs:
    """Let a policy act for all episodes of a trial."""
    runs = Runs.empty(trial.episodes, trial.steps, POLICY_HZ)
    if trial.task is Task.bolt:
        runs.orientation_deg[:] = np.resize(ORIENTATIONS_DEG, trial.episodes)
    for number in range(trial.episodes):
        for t, step in enumerate(episode(policy, environment, trial, number)):
            at, info = (number, t), step.info
            runs.rewards[number] += step.reward
            runs.target_m[at] = info["target_m"]
            if info["drop"]:
                # In the step that loses the object there is no place of it any more.
                runs.dropped[number] = True
                continue
            runs.error_m[at], runs.object_m[at] = info["error_m"], info["position_m"]
            runs.angle_error_rad[at] = info.get("orientation_error_rad", np.nan)
        progress(number + 1)
    return runs
