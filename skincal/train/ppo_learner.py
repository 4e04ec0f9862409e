"""Proximal policy optimisation of Stable-Baselines3, with a critic that sees more than the actor."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import VecNormalize

from skincal.train.learner import ACTOR_KEY, CRITIC_KEY
from skincal.train.sb3_learner import Part, TorchLearner
from skincal.train.settings import PpoSettings


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
