"""Settings of a training run: task and hyperparameters of the published soft actor-critic."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any, Final, cast


class Task(StrEnum):
    """Object between the fingers."""

    marble = "marble"
    bolt = "bolt"
    pellets = "pellets"


class PolicyKind(StrEnum):
    """Observations of a policy (the paper's table "Observation space of different policies")."""

    tactile = "tactile"
    joint_angles = "joint-angles"
    desired = "desired"
    ideal = "ideal"


class BackendName(StrEnum):
    """Backend: Stable-Baselines3 in torch, or the same algorithm in jax."""

    sb3 = "sb3"
    sbx = "sbx"


ENVIRONMENT_IDS: Final = {
    Task.marble: "skincal/MarbleRoll-v0",
    Task.bolt: "skincal/BoltRoll-v0",
    Task.pellets: "skincal/PelletSeparate-v0",
}
"""What gymnasium makes a task by."""

PUBLISHED_STEPS: Final = {Task.marble: 800_000, Task.bolt: 600_000, Task.pellets: 8_000_000}
"""Length of a training run [environment steps], Kasolowsky & Bäuml, IROS 2024, section V-E; pellets: ICRA 2026."""


@dataclass(frozen=True)
class Settings:
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

    environments: int = 8
    buffer_size: int = 200_000
    learning_starts: int = 6000
    train_every: int = 60
    gradient_steps: int = 200
    discount: float = 0.95
    polyak: float = 5e-3
    target_entropy: float = -4.0
    entropy_coefficient: float = 0.2
    learning_rate: float = 3e-4
    batch_size: int = 256
    hidden: tuple[int, ...] = (256, 256)
    observation_clip: float = 10.0

    @property
    def steps_per_round(self) -> int:
        """Environment steps of a round: gather, then learn."""
        return self.environments * self.train_every

    def rounds(self, steps: int) -> int:
        """Rounds that so many environment steps take; the last one is always whole."""
        return -(-steps // self.steps_per_round)


@dataclass(frozen=True)
class PpoSettings:
    """Proximal policy optimisation as published for the pellets (the authors' list of settings, ICRA 2026).

    Attributes:
        environments: how many run side by side.
        rollout_steps: environment steps that are gathered before learning, of all environments together.
        batch_size: steps in an update.
        epochs: passes over what was gathered.
        learning_rate: of Adam.
        discount: of the reward of the next step.
        gae_lambda: of the generalised advantage estimate.
        gradient_clip: largest norm of a gradient.
        value_coefficient: weight of the critic's loss.
        deviation: of the actions at first; assumed.
        hidden: neurons in the hidden layers of actor and critic; assumed.
        observation_clip: normalised observations are cut off here [standard deviations]; assumed.
    """

    environments: int = 160
    rollout_steps: int = 60_000
    batch_size: int = 4000
    epochs: int = 5
    learning_rate: float = 3e-4
    discount: float = 0.99
    gae_lambda: float = 0.95
    gradient_clip: float = 0.5
    value_coefficient: float = 0.5
    deviation: float = 0.4
    hidden: tuple[int, ...] = (256, 256)
    observation_clip: float = 10.0

    @property
    def steps_per_round(self) -> int:
        """Environment steps of a round: gather, then learn."""
        return self.rollout_steps // self.environments * self.environments

    def rounds(self, steps: int) -> int:
        """Rounds that so many environment steps take; the last one is always whole."""
        return -(-steps // self.steps_per_round)


@dataclass(frozen=True)
class Work:
    """One training run: everything its result depends on.

    Attributes:
        task: what is learned.
        policy: what the policy sees.
        seed: of everything random in it.
        steps: environment steps that are planned.
        backend: who does the learning.
        settings: of the algorithm.
        rounds_per_checkpoint: learning rounds between two checkpoints. All environments begin a new episode after a
            checkpoint, so that a run that goes on from it is the same as one that was never interrupted.
        environment: further arguments for the environment, by name.
        start: name of the policy that the run goes on from; "": none, it begins with random networks.
    """

    task: Task
    policy: PolicyKind
    seed: int
    steps: int
    backend: BackendName = BackendName.sb3
    settings: Settings | PpoSettings = field(default_factory=Settings)
    rounds_per_checkpoint: int = 42
    environment: dict[str, Any] = field(default_factory=dict[str, Any])
    start: str = ""

    def as_table(self) -> dict[str, Any]:
        """All of it as plain values, for a file."""
        table = asdict(self)
        table["settings"]["hidden"] = list(self.settings.hidden)
        return {**table, "task": str(self.task), "policy": str(self.policy), "backend": str(self.backend)}

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> Work:
        """Inverse of :meth:`as_table`.

        Raises:
            KeyError, TypeError, ValueError: something is missing, unknown or of a wrong kind.
        """
        settings: dict[str, Any] = {**table["settings"], "hidden": tuple(table["settings"]["hidden"])}
        whole = {name: table[name] for name in ("seed", "steps", "rounds_per_checkpoint")}
        for name, value in (settings | whole).items():
            numbers: tuple[object, ...] = cast("tuple[object, ...]", value) if name == "hidden" else (value,)
            for number in numbers:
                _check(name, number)
        return cls(
            task=Task(table["task"]),
            policy=PolicyKind(table["policy"]),
            backend=BackendName(table["backend"]),
            settings=(PpoSettings if "rollout_steps" in settings else Settings)(**settings),
            environment=dict(table["environment"]),
            start=str(table.get("start", "")),
            **whole,
        )


_BOUNDS: Final[dict[str, tuple[float, float]]] = {
    "environments": (1, 4096), "buffer_size": (1, 10**9), "learning_starts": (0, 10**12), "train_every": (1, 10**6),
    "gradient_steps": (1, 10**6), "discount": (0.0, 1.0), "polyak": (0.0, 1.0), "target_entropy": (-1e6, 1e6),
    "entropy_coefficient": (0.0, 1e6), "learning_rate": (0.0, 1.0), "batch_size": (1, 10**7), "hidden": (1, 10**5),
    "rollout_steps": (1, 10**9), "epochs": (1, 10**4), "gae_lambda": (0.0, 1.0), "gradient_clip": (1e-9, 1e9),
    "value_coefficient": (0.0, 1e6), "deviation": (1e-6, 1e3), "observation_clip": (1e-6, 1e6),
    "seed": (0, 2**63), "steps": (1, 10**12), "rounds_per_checkpoint": (1, 10**9),
}  # fmt: skip
"""What a file may say: beyond it a run would not begin, or never end."""


def _check(name: str, value: object) -> None:
    """Checks a number of a file; those with whole bounds are whole.

    Raises:
        KeyError, ValueError: there is no such setting, or it is out of bounds.
    """
    low, high = _BOUNDS[name]
    kinds = int if isinstance(low, int) else int | float
    if not isinstance(value, kinds) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{name} = {value!r:.40}, not within {low:g} to {high:g}")
