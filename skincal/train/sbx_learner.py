"""Soft actor-critic of sbx, Stable-Baselines3's sibling in jax: the same algorithm, compiled."""

# pyright: reportMissingImports=false
# The extra `sbx` is none of those that checks are made with.

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, ClassVar, cast

import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from flax import serialization
from gymnasium import spaces
from numpy.typing import NDArray
from sbx import SAC
from sbx.common.policies import SquashedGaussianActor
from sbx.sac.policies import SACPolicy
from stable_baselines3.common.vec_env import VecNormalize

from skincal.bounded import MOST_ARRAY_BYTES, read_bytes
from skincal.train.learner import ACTOR_KEY, OffPolicyLearner, published
from skincal.train.settings import Settings


class PartActor(SquashedGaussianActor):
    """An actor that sees some columns of the observation only."""

    first: int = 0
    columns: int = 0

    @nn.compact
    def __call__(self, x: Any) -> Any:
        """Return the distribution of actions for observations (N, O)."""
        x = x.reshape((x.shape[0], -1))[:, self.first : self.first + self.columns]
        return SquashedGaussianActor(
            net_arch=self.net_arch, action_dim=self.action_dim, activation_fn=self.activation_fn
        )(x)


class SbxLearner(OffPolicyLearner):
    """The learner in jax."""

    weights_file: ClassVar[str] = "weights.msgpack"
    model: SAC

    def _make(self, environments: VecNormalize, settings: Settings, seed: int) -> SAC:
        actor = partial(PartActor, **_columns(cast("spaces.Dict", environments.observation_space)))
        return SAC(
            SACPolicy,
            environments,
            seed=seed,
            policy_kwargs={"net_arch": list(settings.hidden), "actor_class": actor},
            **published(settings),
        )

    def save_weights(self, path: Path) -> None:
        """Write networks, optimisers, entropy coefficient and jax's random keys."""
        path.write_bytes(serialization.to_bytes(self._state()))

    def load_weights(self, path: Path) -> None:
        """Read them; the file holds numbers only."""
        kept = serialization.from_bytes(self._state(), read_bytes(path, MOST_ARRAY_BYTES))
        policy = self.model.policy
        policy.actor_state, policy.qf_state = kept["actor"], kept["critic"]
        self.model.ent_coef_state = kept["entropy"]
        self.model.key, policy.key, policy.noise_key = (jnp.asarray(key) for key in kept["random"])

    def _state(self) -> dict[str, Any]:
        policy = self.model.policy
        return {
            "actor": policy.actor_state,
            "critic": policy.qf_state,
            "entropy": self.model.ent_coef_state,
            "random": [np.asarray(key) for key in (self.model.key, policy.key, policy.noise_key)],
        }

    def _set_actor(self, layers: list[tuple[NDArray[Any], NDArray[Any]]], log_deviation: float) -> None:
        state = self.model.policy.actor_state
        own = dict(state.params["params"]["SquashedGaussianActor_0"])
        for i, (weight, bias) in enumerate(layers):
            own[f"Dense_{i}"] = {"kernel": jnp.asarray(weight), "bias": jnp.asarray(bias)}
        deviation: Any = own[f"Dense_{len(layers)}"]
        own[f"Dense_{len(layers)}"] = {
            "kernel": jnp.zeros_like(deviation["kernel"]),
            "bias": jnp.full_like(deviation["bias"], log_deviation),
        }
        params = {**state.params, "params": {**state.params["params"], "SquashedGaussianActor_0": own}}
        self.model.policy.actor_state = state.replace(params=params)

    def _actor_state(self) -> Any:
        # Nothing is changed in place: learning gives a new state.
        return self.model.policy.actor_state

    def _restore_actor(self, state: Any) -> None:
        self.model.policy.actor_state = state

    def _actor_layers(self) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        layers = self.model.policy.actor_state.params["params"]["SquashedGaussianActor_0"]
        # The hidden layers come first, then the mean, then the logarithm of the deviation.
        names = [f"Dense_{i}" for i in range(len(self.settings.hidden) + 1)]
        return [(np.asarray(layers[name]["kernel"]), np.asarray(layers[name]["bias"])) for name in names]


def _columns(space: spaces.Dict) -> dict[str, int]:
    """Return the columns of the actor's part; sbx concatenates parts of an observation in the order of the space."""
    first = 0
    for key, part in space.items():
        if key == ACTOR_KEY:
            return {"first": first, "columns": spaces.flatdim(part)}
        first += spaces.flatdim(part)
    raise KeyError(ACTOR_KEY)
