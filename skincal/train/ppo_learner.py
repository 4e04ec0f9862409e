"""Proximal policy optimisation of Stable-Baselines3, with a critic that sees more than the actor."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import VecNormalize

from skincal.train.learner import ACTOR_KEY, CRITIC_KEY, Learner
from skincal.train.sb3_learner import Part
from skincal.train.settings import PpoSettings


class Halves(torch.nn.Module):
    """Hidden layers of an actor, on the first columns of what is seen, and of a critic, on all of them."""

    def __init__(self, first: int, columns: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        self._first = first
        self.actor, self.critic = _layers((first, *hidden)), _layers((columns, *hidden))
        self.latent_dim_pi = self.latent_dim_vf = hidden[-1]

    def forward(self, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Both."""
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


class PpoLearner(Learner):
    """Stable-Baselines3's PPO."""

    weights_file: ClassVar[str] = "weights.pt"
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

    def save_weights(self, path: Path) -> None:
        """Writes networks, optimiser and torch's random state."""
        policy = self.model.policy
        kept = {"policy": policy.state_dict(), "optimizer": policy.optimizer.state_dict()}
        torch.save(kept | {"random": torch.get_rng_state()}, path)

    def load_weights(self, path: Path) -> None:
        """Reads them; a file with anything but numbers in it is refused."""
        kept = torch.load(path, weights_only=True)
        self.model.policy.load_state_dict(kept["policy"])
        self.model.policy.optimizer.load_state_dict(kept["optimizer"])
        torch.set_rng_state(kept["random"])

    def _actor_layers(self) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        policy = self.model.policy
        parts = [*policy.mlp_extractor.actor, *policy.action_net]  # type: ignore[misc]
        layers = [part for part in parts if isinstance(part, torch.nn.Linear)]
        return [(layer.weight.detach().numpy().T, layer.bias.detach().numpy()) for layer in layers]


def _layers(sizes: tuple[int, ...]) -> torch.nn.Sequential:
    parts: list[torch.nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        parts += [torch.nn.Linear(inputs, outputs), torch.nn.ReLU()]
    return torch.nn.Sequential(*parts)
