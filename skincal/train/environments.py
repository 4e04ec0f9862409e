"""Parallel environments for a learner."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import gymnasium
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from skincal.ranges import Ranges
from skincal.tasks import ENVIRONMENT_IDS
from skincal.train.settings import Work

if TYPE_CHECKING:
    from skincal.envs.task_options import TaskOptions

Make = Callable[[], "gymnasium.Env[Any, Any]"]


def make_environment(work: Work, ranges: Ranges | None) -> gymnasium.Env[Any, Any]:
    """Return one environment of a task."""
    import skincal.envs  # noqa: F401  # registers the tasks

    name = ENVIRONMENT_IDS[work.task]
    return gymnasium.make(name, policy=str(work.policy), ranges=ranges, **work.environment)


def in_full(work: Work, ranges: Ranges | None) -> Work:
    """A run with the numbers that its environment takes by default, so that it goes on with them when defaults change.

    Rewards and grasp are not among them.

    Raises:
        InputError: the environment cannot be made of this.
    """
    environment = make_environment(work, ranges)
    try:
        options: TaskOptions = cast(Any, environment.unwrapped).options
        return replace(work, environment={**options.numbers, **work.environment})
    finally:
        environment.close()


def parallel(make: Make, number: int, *, processes: bool = False) -> VecEnv:
    """Return several environments side by side."""
    makers = [make] * number
    return SubprocVecEnv(makers, start_method="forkserver") if processes else DummyVecEnv(makers)


def end(environments: VecEnv) -> None:
    """End environments in the middle of their work.

    An orderly close waits for every answer that was asked for, for ever for one that an interrupt has already taken.
    """
    if not isinstance(environments, SubprocVecEnv):
        environments.close()
        return
    for process in environments.processes:
        process.terminate()
    for process in environments.processes:
        process.join()
    for remote in environments.remotes:
        remote.close()
    environments.closed = True


def maker(work: Work, ranges: Ranges | None) -> Make:
    """Return a function without arguments that makes one environment."""
    return partial(make_environment, work, ranges)
