"""Learners of Stable-Baselines3: soft actor-critic and PPO, with critics that see more than the actor."""

from __future__ import annotations

import copy
from abc import abstractmethod
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.policies import ActorCriticPolicy, ContinuousCritic
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecNormalize
from stable_baselines3.sac.policies import Actor, SACPolicy

from skincal.train.learner import ACTOR_KEY, CRITIC_KEY, Learner, OffPolicyLearner, published
from skincal.train.settings import PpoSettings, Settings


class Part(BaseFeaturesExtractor):
    """One part of an observation, or several in a row, as they are."""

    def __init__(self, space: spaces.Dict, keys: tuple[str, ...]) -> None:
        super().__init__(space, sum(spaces.flatdim(space[key]) for key in keys))
        self.keys = keys

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return the parts side by side, shape (N, features)."""
        return torch.cat([observations[key] for key in self.keys], dim=1)


class AsymmetricPolicy(SACPolicy):
    """The actor sees what a robot sees, the critics all that the simulation knows."""

    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> Actor:
        """Return an actor on its part of the observation."""
        return super().make_actor(Part(self._space, (ACTOR_KEY,)))

    def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> ContinuousCritic:
        """Return a pair of critics on the whole observation."""
        return super().make_critic(Part(self._space, (CRITIC_KEY, ACTOR_KEY)))

    @property
    def _space(self) -> spaces.Dict:
        return cast("spaces.Dict", self.observation_space)


class TorchLearner(Learner):
    """Base of the learners in torch: weights in a file of numbers alone."""

    weights_file: ClassVar[str] = "weights.pt"

    def save_weights(self, path: Path) -> None:
        """Write networks, optimisers and torch's random state."""
        kept = {name: part.state_dict() for name, part in self._parts().items()}
        torch.save(kept | self._tensors() | {"random": torch.get_rng_state()}, path)

    def load_weights(self, path: Path) -> None:
        """Read them; a file with anything but numbers in it is refused."""
        kept = torch.load(path, weights_only=True)
        for name, part in self._parts().items():
            part.load_state_dict(kept[name])
        with torch.no_grad():
            for name, tensor in self._tensors().items():
                tensor.copy_(kept[name])
        torch.set_rng_state(kept["random"])

    @abstractmethod
    def _parts(self) -> dict[str, Any]:
        """Return networks and optimisers by their names in the file."""

    def _tensors(self) -> dict[str, torch.Tensor]:
        """Return what else is learned."""
        return {}

    @abstractmethod
    def _actor_linear(self) -> list[torch.nn.Linear]:
        """Return the layers of the actor's mean."""

    def _actor_layers(self) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        layers = self._actor_linear()
        return [(layer.weight.detach().numpy().T, layer.bias.detach().numpy()) for layer in layers]


class Sb3Learner(TorchLearner, OffPolicyLearner):
    """Soft actor-critic of Stable-Baselines3."""

    model: SAC

    def _make(self, environments: VecNormalize, settings: Settings, seed: int) -> SAC:
        return SAC(
            AsymmetricPolicy,
            environments,
            seed=seed,
            policy_kwargs={"net_arch": list(settings.hidden)},
            **published(settings),
        )

    def _set_actor(self, layers: list[tuple[NDArray[Any], NDArray[Any]]], log_deviation: float) -> None:
        actor = self.model.actor
        assert isinstance(actor.log_std, torch.nn.Linear)
        with torch.no_grad():
            for layer, (weight, bias) in zip(self._actor_linear(), layers, strict=True):
                layer.weight.copy_(torch.tensor(weight.T))
                layer.bias.copy_(torch.tensor(bias))
            actor.log_std.weight.zero_()
            actor.log_std.bias.fill_(log_deviation)

    def _actor_state(self) -> Any:
        actor = self.model.actor
        return copy.deepcopy((actor.state_dict(), actor.optimizer.state_dict()))

    def _restore_actor(self, state: Any) -> None:
        actor = self.model.actor
        actor.load_state_dict(state[0])
        actor.optimizer.load_state_dict(state[1])

    def _parts(self) -> dict[str, Any]:
        model = self.model
        return {
            "policy": model.policy,
            "actor_optimizer": model.actor.optimizer,
            "critic_optimizer": model.critic.optimizer,
            "entropy_optimizer": model.ent_coef_optimizer,
        }

    def _tensors(self) -> dict[str, torch.Tensor]:
        assert self.model.log_ent_coef is not None
        return {"log_ent_coef": self.model.log_ent_coef.detach()}

    def _actor_linear(self) -> list[torch.nn.Linear]:
        actor = self.model.actor
        assert isinstance(actor.mu, torch.nn.Linear)
        return [*(layer for layer in actor.latent_pi if isinstance(layer, torch.nn.Linear)), actor.mu]


class Halves(torch.nn.Module):
    """Hidden layers of an actor, on the first columns of what is seen, and of a critic, on all of them."""

    def __init__(self, first: int, columns: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        self._first = first
        self.actor, self.critic = _layers((first, *hidden)), _layers((columns, *hidden))
        self.latent_dim_pi = self.latent_dim_vf = hidden[-1]

    def forward(self, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the features of actor and critic (N, hidden)."""
        return self.forward_actor(seen), self.forward_critic(seen)

    def forward_actor(self, seen: torch.Tensor) -> torch.Tensor:
        """Return the actor's features (N, hidden)."""
        return self.actor(seen[:, : self._first])

    def forward_critic(self, seen: torch.Tensor) -> torch.Tensor:
        """Return the critic's features (N, hidden)."""
        return self.critic(seen)


class HalvesPolicy(ActorCriticPolicy):
    """An actor whose mean action ends in tanh, as policy files have it, and a critic that sees all."""

    def _build_mlp_extractor(self) -> None:
        space = self.observation_space
        assert isinstance(space, spaces.Dict)
        first = spaces.flatdim(space[ACTOR_KEY])
        hidden = tuple(self.net_arch)
        self.mlp_extractor = Halves(first, self.features_dim, hidden)  # type: ignore[assignment,arg-type]

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        # The optimiser has the layer's parameters already; tanh has none.
        self.action_net = torch.nn.Sequential(self.action_net, torch.nn.Tanh())


class PpoLearner(TorchLearner):
    """Proximal policy optimisation of Stable-Baselines3."""

    settings: PpoSettings
    model: PPO

    def _make(self, environments: VecNormalize, settings: PpoSettings, seed: int) -> PPO:
        return PPO(
            HalvesPolicy,
            environments,
            seed=seed,
            n_steps=settings.rollout_steps // settings.environments,
            batch_size=settings.batch_size,
            n_epochs=settings.epochs,
            learning_rate=settings.learning_rate,
            gamma=settings.discount,
            gae_lambda=settings.gae_lambda,
            max_grad_norm=settings.gradient_clip,
            vf_coef=settings.value_coefficient,
            policy_kwargs={
                "net_arch": list(settings.hidden),
                "log_std_init": float(np.log(settings.deviation)),
                "features_extractor_class": Part,
                "features_extractor_kwargs": {"keys": (ACTOR_KEY, CRITIC_KEY)},
            },
            device="cpu",
        )

    def _parts(self) -> dict[str, Any]:
        return {"policy": self.model.policy, "optimizer": self.model.policy.optimizer}

    def _actor_linear(self) -> list[torch.nn.Linear]:
        policy = self.model.policy
        parts = [*policy.mlp_extractor.actor, *policy.action_net]  # type: ignore[misc]
        return [part for part in parts if isinstance(part, torch.nn.Linear)]


def _layers(sizes: tuple[int, ...]) -> torch.nn.Sequential:
    parts: list[torch.nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        parts += [torch.nn.Linear(inputs, outputs), torch.nn.ReLU()]
    return torch.nn.Sequential(*parts)
