"""A task as small as can be with the interface of the real ones: keep a point on a moving target.

The policy sees the last five differences between target and point, with noise; the critic sees the point itself.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

ID = "skincal-test/Toy-v0"
STEPS = 60
STACK = 5


class ToyTask(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self, policy: str = "tactile", ranges: Any = None, noise: float = 0.1) -> None:
        self.policy, self.ranges, self.noise = policy, ranges, noise
        box = {"critic": spaces.Box(-np.inf, np.inf, (4,), np.float32),
               "policy": spaces.Box(-np.inf, np.inf, (2 * STACK,), np.float32)}  # fmt: skip
        self.observation_space = spaces.Dict(box)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        self.point = self.np_random.uniform(-1, 1, 2)
        self.phase = self.np_random.uniform(0, 2 * np.pi)
        self.step_number = 0
        self.steps = round(10 * (options or {}).get("duration_s", STEPS / 10))
        self.seen = np.tile(self._look(), (STACK, 1))
        return self._observation(), {"randomized": {"phase": self.phase}}

    def step(self, action: np.ndarray):
        self.step_number += 1
        self.point = self.point + 0.3 * np.asarray(action, np.float64)
        self.seen = np.vstack([self.seen[1:], self._look()])
        error = float(np.linalg.norm(self.target - self.point))
        drop = error > 3.0
        info = {
            "error_m": 1e-3 * error,
            "drop": drop,
            "reward_terms": {"position": -error},
            "randomized": {},
            "position_m": 1e-3 * self.point,
            "target_m": 1e-3 * self.target,
        }
        return self._observation(), max(0.0, 1.0 - error), drop, self.step_number >= self.steps, info

    @property
    def target(self) -> np.ndarray:
        angle = self.phase + 0.1 * self.step_number
        return np.array([np.cos(angle), np.sin(angle)])

    def _look(self) -> np.ndarray:
        return self.target - self.point + self.noise * self.np_random.normal(size=2)

    def _observation(self) -> dict[str, np.ndarray]:
        exact = np.concatenate([self.point, self.target])
        return {"critic": exact.astype(np.float32), "policy": self.seen.ravel().astype(np.float32)}


def register() -> None:
    if ID not in gymnasium.registry:
        gymnasium.register(ID, entry_point=ToyTask, disable_env_checker=True)
