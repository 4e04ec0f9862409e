"""Settings of a training run: task and hyperparameters of the published soft actor-critic."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Annotated, Any

import numpy as np

from skincal.dataset.keys import Key, Word
from skincal.dataset.schema import Table
from skincal.tasks import BackendName, PolicyKind, Task


class Within(Key):
    """A number within bounds; beyond them a run would not begin, or never end."""

    def __init__(self, low: float, high: float) -> None:
        super().__init__(f"{low:g} to {high:g}", low, high)


@dataclass(frozen=True)
class Settings(Table, unknown="refuse"):
    """Soft actor-critic as published (Kasolowsky & Bäuml, IROS 2024, and the authors' list of settings).

    Attributes:
        environments: how many run side by side.
        buffer_size: transitions that are remembered, of all environments together.
        learning_starts: environment steps with random actions, before anything is learned; in a run that goes on from a
            policy, steps in which the critics alone learn.
        train_every: steps of each environment between two learning phases.
        gradient_steps: updates in a learning phase.
        discount: of the reward of the next step.
        polyak: share of the critic that the target critic takes over at an update.
        target_entropy: of the policy, six actions together [nat].
        entropy_coefficient: at the beginning; then it is learned.
        learning_rate: of Adam, for actor, critics and entropy coefficient.
        batch_size: transitions in an update.
        hidden: neurons in the hidden layers of actor and critics.
        observation_clip: normalised observations are cut off here [standard deviations].
    """

    environments: Annotated[int, Within(1, 4096)] = 8
    buffer_size: Annotated[int, Within(1, 10**9)] = 200_000
    learning_starts: Annotated[int, Within(0, 10**12)] = 6000
    train_every: Annotated[int, Within(1, 10**6)] = 60
    gradient_steps: Annotated[int, Within(1, 10**6)] = 200
    discount: Annotated[float, Within(0, 1)] = 0.95
    polyak: Annotated[float, Within(0, 1)] = 5e-3
    target_entropy: Annotated[float, Within(-1e06, 1e06)] = -4.0
    entropy_coefficient: Annotated[float, Within(0, 1e06)] = 0.2
    learning_rate: Annotated[float, Within(0, 1)] = 3e-4
    batch_size: Annotated[int, Within(1, 10**7)] = 256
    hidden: Annotated[tuple[int, ...], Within(1, 10**5)] = (256, 256)
    observation_clip: Annotated[float, Within(1e-06, 1e06)] = 10.0

    @property
    def steps_per_round(self) -> int:
        """Environment steps of a round: gather, then learn."""
        return self.environments * self.train_every


@dataclass(frozen=True)
class PpoSettings(Table, unknown="refuse"):
    """Proximal policy optimisation as published for the pellets (the authors' list of settings, ICRA 2026).

    Attributes:
        environments: how many run side by side.
        rollout_steps: environment steps that are gathered before learning, of all environments together.
        batch_size: steps in an update.
        epochs: passes over what was gathered.
        discount: of the reward of the next step.
        gae_lambda: of the generalised advantage estimate.
        value_coefficient: weight of the critic's loss.
        deviation: of the actions at first; assumed.
        hidden: neurons in the hidden layers of actor and critic; assumed.
        observation_clip: normalised observations are cut off here [standard deviations]; assumed.
    """

    environments: Annotated[int, Within(1, 4096)] = 160
    rollout_steps: Annotated[int, Within(1, 10**9)] = 60_000
    batch_size: Annotated[int, Within(1, 10**7)] = 4000
    epochs: Annotated[int, Within(1, 10000)] = 5
    learning_rate: Annotated[float, Within(0, 1)] = 3e-4
    discount: Annotated[float, Within(0, 1)] = 0.99
    gae_lambda: Annotated[float, Within(0, 1)] = 0.95
    gradient_clip: Annotated[float, Within(1e-09, 1e09)] = 0.5
    value_coefficient: Annotated[float, Within(0, 1e06)] = 0.5
    deviation: Annotated[float, Within(1e-06, 1000)] = 0.4
    hidden: Annotated[tuple[int, ...], Within(1, 10**5)] = (256, 256)
    observation_clip: Annotated[float, Within(1e-06, 1e06)] = 10.0

    @property
    def steps_per_round(self) -> int:
        """Environment steps of a round: gather, then learn."""
        return self.rollout_steps // self.environments * self.environments


@dataclass(frozen=True)
class Work(Table, unknown="keep"):
    """One training run: everything its result depends on.

    Attributes:
        seed: of everything random in it.
        steps: environment steps that are planned.
        backend: who does the learning.
        rounds_per_checkpoint: learning rounds between two checkpoints. All environments begin a new episode after a
            checkpoint, so that a run that goes on from it is the same as one that was never interrupted.
        environment: further arguments for the environment, by name.
        start: name of the policy that the run goes on from; "": none, it begins with random networks.
    """

    task: Annotated[Task, Word(options=Task)]
    policy: Annotated[PolicyKind, Word(options=PolicyKind)]
    seed: Annotated[int, Within(0, 2**63)]
    steps: Annotated[int, Within(1, 10**12)]
    backend: Annotated[BackendName, Word(options=BackendName)] = BackendName.sb3
    settings: Settings | PpoSettings = field(default_factory=Settings)
    rounds_per_checkpoint: Annotated[int, Within(1, 10**9)] = 42
    environment: dict[str, Any] = field(default_factory=dict[str, Any])
    start: str = ""

    def as_table(self) -> dict[str, Any]:
        """Return all of it as plain values, for a file."""
        table = asdict(self)
        table["settings"]["hidden"] = list(self.settings.hidden)
        return {**table, "task": str(self.task), "policy": str(self.policy), "backend": str(self.backend)}


def part_seed(seed: int, part: int) -> int:
    """Return the seed of a part: an episode of an evaluation, or a run's environments between two checkpoints."""
    return int(np.random.SeedSequence([seed, part]).generate_state(1)[0] >> 1)


def rounds_of(settings: Settings | PpoSettings, steps: int) -> int:
    """Return the rounds that so many environment steps take; the last one is always whole."""
    return -(-steps // settings.steps_per_round)
