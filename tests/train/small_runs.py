"""Small training runs on the toy task."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gymnasium
import toy_task

from skincal.ranges import preset
from skincal.train import BackendName, PolicyKind, PpoSettings, Settings, Task, Trained, Work, begin, train

SMALL = Settings(
    environments=2,
    buffer_size=160,  # less than a run: the buffer goes round
    learning_starts=40,
    train_every=20,
    gradient_steps=5,
    target_entropy=-2.0,
    batch_size=32,
    hidden=(16, 16),
)
SMALL_PPO = PpoSettings(environments=2, rollout_steps=40, batch_size=20, epochs=2, hidden=(16, 16))
CHECKPOINT_STEPS = 80


def make() -> gymnasium.Env:
    toy_task.register()
    return gymnasium.make(toy_task.ID)


def work(backend: str = "sb3", seed: int = 3) -> Work:
    if backend == "ppo":
        return replace(work("sb3", seed), settings=SMALL_PPO)
    return Work(Task.marble, PolicyKind.tactile, seed, 320, BackendName(backend), SMALL, 2)


def run(folder: Path, steps: int, backend: str = "sb3", seed: int = 3) -> Trained:
    """Begins a run, or goes on with it."""
    if not folder.exists():
        begin(work(backend, seed), preset("iros24"), folder)
    return train(folder, make, steps)
