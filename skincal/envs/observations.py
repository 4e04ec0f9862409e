"""Observations of policies and critics: parts, order, bounds."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.envs.drawing import EFFECTS_PREFIX, Values
from skincal.envs.world import View
from skincal.model.arrays import FloatArray
from skincal.tasks import PolicyKind

Observation = dict[str, NDArray[np.float32]]

STACKED: Final = 5
"""Observations that a policy sees: the present one and four before it (the paper's)."""
KINDS: Final[dict[PolicyKind, tuple[str, ...]]] = {
    PolicyKind.tactile: ("image", "desired"),
    PolicyKind.joint_angles: ("desired", "measured", "error"),
    PolicyKind.desired: ("desired",),
    PolicyKind.ideal: ("truth", "desired"),
}
"""Stacked parts of each policy's observation, as published; ``ideal`` is the output of a perfect skin."""
TASK: Final = ("target", "movement")
"""Parts that every policy observes once: the target and its change."""


@dataclass(frozen=True)
class Part:
    """Some numbers of an observation."""

    name: str
    size: int
    low: float
    high: float


class Layout:
    """Parts one after the other, in one array."""

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = tuple(parts)
        self.low = np.concatenate([np.full(p.size, p.low) for p in parts])
        self.high = np.concatenate([np.full(p.size, p.high) for p in parts])
        ends = np.cumsum([p.size for p in parts]).tolist()
        self._slices = [(p.name, slice(end - p.size, end)) for p, end in zip(parts, ends, strict=True)]

    def fill(self, values: Mapping[str, Any]) -> FloatArray:
        """Return the array (size,): values are clipped to their bounds, and NaN becomes 0."""
        flat = np.empty(len(self.low))
        for name, where in self._slices:
            flat[where] = values[name]
        # A sum of squares is finite where all its terms are, and it never meets infinity less infinity.
        if not math.isfinite(float(np.vdot(flat, flat))):
            np.nan_to_num(flat, copy=False, posinf=np.inf, neginf=-np.inf)
        np.maximum(flat, self.low, out=flat)
        return np.minimum(flat, self.high, out=flat)


class ObservationStack:
    """The observation spaces of a policy and its critic, and the stack of past observations."""

    def __init__(
        self,
        kind: PolicyKind,
        nominal: Values,
        *,
        joints: int,
        taxels: int,
        counts: tuple[float, float],
        objects: int,
        target: int,
        limit: float,
        ahead: int,
        own: int,
    ) -> None:
        parts = {
            "image": Part("image", taxels, *counts),
            "desired": Part("desired", joints, -np.pi, np.pi),
            "measured": Part("measured", joints, -2 * np.pi, 2 * np.pi),
            "error": Part("error", joints, -2 * np.pi, 2 * np.pi),
            "truth": Part("truth", 3 * objects, -200.0, 200.0),
        }
        self.now = Layout([parts[name] for name in KINDS[kind]])
        self.task = Layout([Part(name, target, -limit, limit) for name in TASK])
        self.critic = Layout(state_parts(joints, target, ahead, limit, own))
        self._constant = Layout(constant_parts(nominal))
        self._stack: deque[FloatArray] = deque(maxlen=STACKED)
        policy, critic = _box(*[self.now] * STACKED, self.task), _box(self.critic, self._constant)
        self.space = gymnasium.spaces.Dict({"policy": policy, "critic": critic})

    def layout(self) -> tuple[dict[str, Any], ...]:
        """Return the parts of the policy's observation in their order: ``name``, ``size``, and ``steps_ago``."""
        stacked = [(part, ago) for ago in reversed(range(STACKED)) for part in self.now.parts]
        parts = [*stacked, *((part, 0) for part in self.task.parts)]
        return tuple({"name": part.name, "size": part.size, "steps_ago": ago} for part, ago in parts)

    def begin(self, constant: Mapping[str, Any]) -> None:
        """Forget the past observations."""
        self._stack.clear()
        self._constant_values = self._constant.fill(constant)

    def observe(self, values: Mapping[str, Any], critic: Mapping[str, Any]) -> Observation:
        """Return the next observation; at the beginning of an episode the first one stands for those before it."""
        now = self.now.fill(values)
        self._stack.append(now)
        while len(self._stack) < STACKED:
            self._stack.append(now)
        policy = np.concatenate([*self._stack, self.task.fill(values)])
        return {
            "policy": policy.astype(np.float32),
            "critic": np.concatenate([self.critic.fill(critic), self._constant_values]).astype(np.float32),
        }


def _box(*layouts: Layout) -> gymnasium.spaces.Box:
    low, high = (np.concatenate([getattr(one, end) for one in layouts]) for end in ("low", "high"))
    return gymnasium.spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


_LEFT_OUT: Final = (
    "noise", "random_force", "position_m", "psi_deg", "theta_deg", "phi_deg", "taxel", "reference_radius"
)  # fmt: skip
"""Draws that are over, that change in every step, or that no range varies."""


def constant_parts(nominal: Values) -> list[Part]:
    """Return the parts for the draws of an episode, in the order of the names."""
    return [
        Part(path, int(np.size(value)), -1e12, 1e12)
        for path, value in nominal.items()
        if not path.startswith(EFFECTS_PREFIX) and not any(word in path for word in _LEFT_OUT)
    ]


def state_parts(joints: int, target: int, ahead: int, limit: float, own: int) -> list[Part]:
    """Return the parts of the true state."""
    parts = [
        Part("angles", joints, -10.0, 10.0),
        Part("speeds", joints, -100.0, 100.0),
        Part("motor", joints, -10.0, 10.0),
        Part("desired", joints, -10.0, 10.0),
        Part("true_error", joints, -10.0, 10.0),
        Part("body", 3, -1.0, 1.0),
        Part("body_axis", 3, -1.0, 1.0),
        Part("velocity", 3, -10.0, 10.0),
        Part("spin", 3, -1e4, 1e4),
        Part("position", 2, -0.1, 0.1),
        Part("to_target", 2, -0.2, 0.2),
        Part("distance", 1, 0.0, 1.0),
        Part("target", target, -limit, limit),
        Part("movement", target, -limit, limit),
        Part("ahead", ahead * target, -2 * limit, 2 * limit),
        Part("orientation", 4, -np.pi, np.pi),
        Part("skin_force", 1, 0.0, 1e3),
        Part("skin_normal", 3, -1.0, 1.0),
        Part("skin_friction", 3, -1e3, 1e3),
        Part("thumb_force", 1, 0.0, 1e3),
        Part("thumb_place", 3, -1.0, 1.0),
        Part("thumb_normal", 3, -1.0, 1.0),
        Part("held", 1, 0.0, 1.0),
    ]
    return [*parts, Part("own", own, -1e3, 1e3)] if own else parts


def state_values(view: View, own: Mapping[str, ArrayLike]) -> dict[str, Any]:
    """Return the parts of the true state by their names."""
    skin, thumb = view.skin, view.thumb
    vectors = np.zeros((6, 3))
    vectors[0], vectors[1] = view.body.rotation[:, 0], view.velocity_m_per_s
    vectors[2] = view.spin_rad_per_s
    if skin:
        vectors[3], vectors[4] = skin.normal, skin.friction_n
    if thumb:
        vectors[5] = thumb.normal
    axis, velocity, spin, skin_normal, skin_friction, thumb_normal = view.tip.turned(vectors)
    return {
        **own,
        "angles": view.q_rad,
        "speeds": view.dq_rad_per_s,
        "body": view.tip.inside(view.body.origin_m),
        "body_axis": axis,
        "velocity": velocity,
        "spin": spin,
        "position": view.position_m,
        "skin_force": skin.force_n if skin else 0.0,
        "skin_normal": skin_normal,
        "skin_friction": skin_friction,
        "thumb_force": thumb.force_n if thumb else 0.0,
        "thumb_place": view.thumb_tip.inside(np.array(thumb.point_m)) if thumb else np.zeros(3),
        "thumb_normal": thumb_normal,
        "held": float(view.held),
    }
