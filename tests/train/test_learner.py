"""Parallel environments that are ended in the middle of their work."""

from __future__ import annotations

import multiprocessing

import gymnasium
import numpy as np
import pytest

vec_env = pytest.importorskip("stable_baselines3.common.vec_env", reason="needs skincal[train]")

from skincal.train.learner import end, parallel  # noqa: E402


def make() -> gymnasium.Env:
    return gymnasium.make("Pendulum-v1")


def test_environments_end_with_and_without_an_answer():
    environments = parallel(make, 2, processes=True)
    assert isinstance(environments, vec_env.SubprocVecEnv)
    environments.reset()
    environments.step_async(np.zeros((2, 1), dtype=np.float32))
    environments.remotes[0].recv()  # as far as an interrupted step came
    processes = list(environments.processes)
    end(environments)
    assert not any(process.is_alive() for process in processes)
    assert not set(processes) & set(multiprocessing.active_children())
    environments.close()  # is closed already


def test_environments_in_this_process_are_closed():
    environments = parallel(make, 2)
    assert isinstance(environments, vec_env.DummyVecEnv)
    end(environments)
