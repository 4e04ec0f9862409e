"""Interface of a backend to a training run, the part that backends share, and the environments they learn on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, cast

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecNormalize

from skincal.errors import input_error
from skincal.ranges import Ranges
from skincal.tasks import ENVIRONMENT_IDS
from skincal.train.curve import Round, RoundWatch
from skincal.train.policy_file import EPSILON, Network
from skincal.train.settings import Settings, Work

if TYPE_CHECKING:
    from skincal.envs.task_options import TaskOptions

Make = Callable[[], "gymnasium.Env[Any, Any]"]

ACTOR_KEY: Final = "policy"
"""The part of an observation that the actor sees; the critics see all of it."""

CRITIC_KEY: Final = "critic"

Arrays = dict[str, NDArray[Any]]


class Normalised(VecNormalize):
    """Normalises in 32 bits: the buffer's samples are normalised each time, in 64 bits a sixth of a run."""

    def _normalize_obs(self, obs: NDArray[Any], obs_rms: RunningMeanStd) -> NDArray[Any]:
        mean = obs_rms.mean.astype(np.float32)
        scale = (1.0 / np.sqrt(obs_rms.var + self.epsilon)).astype(np.float32)
        result = np.subtract(obs, mean, dtype=np.float32)
        result *= scale
        return np.clip(result, -self.clip_obs, self.clip_obs, out=result)


class Learner(ABC):
    """An actor and critics that learn on parallel environments, with all of their state accessible.

    Args:
        environments: as vectorised; observations are dictionaries with the keys ``policy`` and ``critic``.
    """

    weights_file: ClassVar[str]

    model: Any

    def __init__(self, environments: VecEnv, settings: Any, seed: int) -> None:
        self.settings = settings
        self.normalised = Normalised(environments, norm_reward=False, clip_obs=settings.observation_clip)
        self.model = self._make(self.normalised, settings, seed)
        # A logger of one's own stays from one part of the run to the next; it writes nothing.
        self.model.set_logger(Logger(folder=None, output_formats=[]))
        self._watch = RoundWatch()

    def go_on_from(self, network: Network | None, steps: int) -> None:
        """Initialise the actor from a policy; at first the critics alone learn, as they are untrained.

        Raises:
            InputError: the algorithm does not do that.
        """
        del steps
        if network is None:
            return
        got = type(self.model).__name__
        raise input_error("--from", "a task that is learned with soft actor-critic", got)

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self.model.num_timesteps

    def learn(self, rounds: int, seed: int, progress: Callable[[Round], None]) -> None:
        """Gather and learn for so many rounds, beginning with new episodes."""
        self.normalised.seed(seed)
        # Without a last observation the learner resets its environments; the transition before was stored as one
        # that goes on, so nothing of the cut is seen in the buffer.
        self.model._last_obs = None
        self._watch.report = progress
        steps = rounds * self.settings.steps_per_round
        self.model.learn(steps, callback=self._watch, reset_num_timesteps=False, log_interval=None)  # type: ignore[arg-type]

    def network(self) -> Network:
        """Return the policy as it is now."""
        seen = self._statistics[ACTOR_KEY]
        return Network.build(seen.mean, seen.var, self.settings.observation_clip, self._actor_layers())

    def arrays(self) -> Arrays:
        """The state except for networks and optimisers: normalisation and counters."""
        counters = [self.model.num_timesteps, self.model._n_updates, self.model._episode_num]
        found: Arrays = {"counters": np.array(counters, dtype=np.int64)}
        for key, value in self._statistics.items():
            found |= {f"seen/{key}/mean": value.mean, f"seen/{key}/var": value.var}
            found[f"seen/{key}/count"] = np.array(value.count)
        return found

    def restore(self, arrays: Arrays) -> None:
        """Take over what :meth:`arrays` gave."""
        model = self.model
        model.num_timesteps, model._n_updates, model._episode_num = (int(n) for n in arrays["counters"])
        for key, value in self._statistics.items():
            value.mean, value.var = arrays[f"seen/{key}/mean"].copy(), arrays[f"seen/{key}/var"].copy()
            value.count = float(arrays[f"seen/{key}/count"])

    def random_state(self) -> dict[str, Any]:
        """State of the generators that sampling and random actions draw from, as JSON has it.

        Stable-Baselines3 samples its buffer with numpy's global generator; there is no other to hand it.
        """
        state = np.random.get_state(legacy=False)  # noqa: NPY002
        assert isinstance(state, dict)
        numpy = {**state, "state": {**state["state"], "key": state["state"]["key"].tolist()}}
        return {"numpy": numpy, "actions": self.model.action_space.np_random.bit_generator.state}

    def restore_random(self, state: dict[str, Any]) -> None:
        """Take over what :meth:`random_state` gave."""
        numpy = state["numpy"]
        key = np.array(numpy["state"]["key"], dtype=np.uint32)
        np.random.set_state({**numpy, "state": {**numpy["state"], "key": key}})  # noqa: NPY002
        self.model.action_space.np_random.bit_generator.state = state["actions"]

    @abstractmethod
    def save_weights(self, path: Path) -> None:
        """Write networks, optimisers, and the backend's own random state; nothing in it is code."""

    @abstractmethod
    def load_weights(self, path: Path) -> None:
        """Inverse of :meth:`save_weights`."""

    @abstractmethod
    def _make(self, environments: VecNormalize, settings: Any, seed: int) -> Any:
        """Return the model."""

    @abstractmethod
    def _actor_layers(self) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        """Return weights (inputs, outputs) and biases of the actor's mean."""

    @property
    def _statistics(self) -> dict[str, RunningMeanStd]:
        statistics = self.normalised.obs_rms
        assert isinstance(statistics, dict)
        return statistics


class OffPolicyLearner(Learner):
    """Soft actor-critic, with a replay buffer."""

    settings: Settings

    def go_on_from(self, network: Network | None, steps: int) -> None:
        """Initialise the actor from a policy; before ``learning_starts`` the untrained critics learn alone."""
        model, most = self.model, self.settings.learning_starts
        model.learning_starts = 0
        learn = model.train

        def learn_held(*arguments: Any, **named: Any) -> None:
            kept = self._actor_state() if model.num_timesteps <= most else None
            learn(*arguments, **named)
            if kept is not None:
                self._restore_actor(kept)

        model.train = learn_held  # type: ignore[method-assign]
        if network is None:
            return
        seen = self._statistics[ACTOR_KEY]
        seen.mean, seen.count = network.mean.astype(np.float64), float(steps)
        seen.var = np.maximum(1.0 / network.scale.astype(np.float64) ** 2 - EPSILON, 0.0)
        # The deviation at which independent normal actions have the entropy that is aimed at.
        deviation = self.settings.target_entropy / network.actions - 0.5 * np.log(2 * np.pi * np.e)
        self._set_actor(list(zip(network.weights, network.biases, strict=True)), float(deviation))

    def arrays(self) -> Arrays:
        """See :meth:`Learner.arrays`; with the filled part of the replay buffer, shapes (steps, environments, …)."""
        buffer = self._buffer
        filled = buffer.buffer_size if buffer.full else buffer.pos
        arrays = {f"buffer/{name}": part[:filled] for name, part in _buffer_parts(buffer).items()}
        return super().arrays() | arrays | {"buffer_at": np.array([buffer.pos, int(buffer.full)])}

    def restore(self, arrays: Arrays) -> None:
        """See :meth:`Learner.restore`."""
        super().restore(arrays)
        buffer, (position, full) = self._buffer, arrays["buffer_at"]
        buffer.pos, buffer.full = int(position), bool(full)
        for name, part in _buffer_parts(buffer).items():
            kept = arrays[f"buffer/{name}"]
            part[: len(kept)] = kept

    @abstractmethod
    def _set_actor(self, layers: list[tuple[NDArray[Any], NDArray[Any]]], log_deviation: float) -> None:
        """Take over layers, as :meth:`_actor_layers` gives them, with one deviation for all actions."""

    @abstractmethod
    def _actor_state(self) -> Any:
        """Return the actor's networks and optimiser, as they are now."""

    @abstractmethod
    def _restore_actor(self, state: Any) -> None:
        """Take over what :meth:`_actor_state` gave."""

    @property
    def _buffer(self) -> DictReplayBuffer:
        buffer = self.model.replay_buffer
        assert isinstance(buffer, DictReplayBuffer)
        return buffer


def published(settings: Settings) -> dict[str, Any]:
    """Return the settings by the names that both backends know them by."""
    return {
        "learning_rate": settings.learning_rate,
        "buffer_size": settings.buffer_size,
        "learning_starts": settings.learning_starts,
        "batch_size": settings.batch_size,
        "tau": settings.polyak,
        "gamma": settings.discount,
        "train_freq": (settings.train_every, "step"),
        "gradient_steps": settings.gradient_steps,
        "ent_coef": f"auto_{settings.entropy_coefficient}",
        "target_entropy": settings.target_entropy,
        "device": "cpu",
    }


def _buffer_parts(buffer: DictReplayBuffer) -> Arrays:
    parts: Arrays = {"actions": buffer.actions, "rewards": buffer.rewards, "dones": buffer.dones}
    parts["timeouts"] = buffer.timeouts
    for key in buffer.observations:
        parts |= {f"before/{key}": buffer.observations[key], f"after/{key}": buffer.next_observations[key]}
    return parts


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
