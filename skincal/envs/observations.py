"""What policies and critics see, and in which order."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Observation = dict[str, NDArray[np.float32]]
PolicyKind = Literal["tactile", "joint-angles", "desired"]

STACKED: Final = 5
"""Observations that a policy sees: the present one and four before it (the paper's)."""
KINDS: Final[dict[str, tuple[str, ...]]] = {
    "tactile": ("image", "desired"),
    "joint-angles": ("desired", "measured", "error"),
    "desired": ("desired",),
}
"""What each policy sees five times (the paper's table of observation spaces)."""
TASK: Final = ("target", "movement")
"""What every policy sees once: the target and its change."""


@dataclass(frozen=True)
class Part:
    """Some numbers of an observation.

    Attributes:
        name: what they are.
        size: how many.
        low: below this they are cut off.
        high: above this they are cut off.
    """

    name: str
    size: int
    low: float
    high: float


class Layout:
    """Parts one after the other, as one array of 32-bit floats.

    Args:
        parts: in their order.
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = tuple(parts)
        self.low = np.concatenate([np.full(p.size, p.low) for p in parts])
        self.high = np.concatenate([np.full(p.size, p.high) for p in parts])

    @property
    def size(self) -> int:
        """How many numbers."""
        return len(self.low)

    def slices(self) -> dict[str, slice]:
        """Where each part stands."""
        ends = np.cumsum([0, *(p.size for p in self.parts)]).tolist()
        return {p.name: slice(a, b) for p, a, b in zip(self.parts, ends[:-1], ends[1:], strict=True)}

    def fill(self, values: Mapping[str, Any]) -> FloatArray:
        """The array (size,): what is not finite is cut off as well."""
        flat = np.concatenate([np.ravel(values[p.name]) for p in self.parts])
        return np.clip(np.nan_to_num(flat, posinf=np.inf, neginf=-np.inf), self.low, self.high)


class Seen:
    """The observation spaces of a policy and its critic, and the stack of what was seen.

    Args:
        kind: of the policy.
        joints: number of joints n.
        taxels: number of taxels J.
        counts: smallest and largest count of a taxel.
        target: number of coordinates of the target.
        critic: what the critic sees besides.
    """

    def __init__(
        self,
        kind: PolicyKind,
        joints: int,
        taxels: int,
        counts: tuple[float, float],
        target: int,
        critic: Sequence[Part],
    ) -> None:
        parts = {
            "image": Part("image", taxels, *counts),
            "desired": Part("desired", joints, -np.pi, np.pi),
            "measured": Part("measured", joints, -2 * np.pi, 2 * np.pi),
            "error": Part("error", joints, -2 * np.pi, 2 * np.pi),
        }
        self.now = Layout([parts[name] for name in KINDS[kind]])
        self.task = Layout([Part("target", target, -0.05, 0.05), Part("movement", target, -0.05, 0.05)])
        self.critic = Layout(critic)
        self._stack: deque[FloatArray] = deque(maxlen=STACKED)
        low = np.concatenate([*[self.now.low] * STACKED, self.task.low])
        high = np.concatenate([*[self.now.high] * STACKED, self.task.high])
        self.space = gymnasium.spaces.Dict(
            {"policy": _box(low, high), "critic": _box(self.critic.low, self.critic.high)}
        )

    def begin(self) -> None:
        """Forgets what was seen."""
        self._stack.clear()

    def observe(self, values: Mapping[str, Any], critic: Mapping[str, Any]) -> Observation:
        """The next observation; at the beginning of an episode the first one stands for those before it.

        Args:
            values: what the policy may see, by part.
            critic: what the critic sees, by part.
        """
        now = self.now.fill(values)
        self._stack.append(now)
        while len(self._stack) < STACKED:
            self._stack.append(now)
        policy = np.concatenate([*self._stack, self.task.fill(values)])
        return {
            "policy": policy.astype(np.float32),
            "critic": self.critic.fill(critic).astype(np.float32),
        }


def _box(low: FloatArray, high: FloatArray) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
