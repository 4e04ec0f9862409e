"""Critic observations: the true state and the episode's draws."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from skincal.envs.drawing import Values
from skincal.envs.observations import Part
from skincal.envs.sensing import View

_LEFT_OUT: Final = ("noise", "random_force", "position_m", "psi_deg", "theta_deg", "phi_deg", "taxel")
"""Draws that are over, or that change in every step."""


def constant_parts(nominal: Values) -> list[Part]:
    """Return what an episode was drawn with, in the order of the names."""
    return [Part(path, int(np.size(nominal[path])), -1e12, 1e12) for path in _constant_names(nominal)]


def state_parts(joints: int, target: int, ahead: int, limit: float = 0.05, own: int = 0) -> list[Part]:
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


def state_values(seen: View, own: Mapping[str, ArrayLike]) -> dict[str, Any]:
    """Return the parts of the true state by their names."""
    skin, thumb = seen.skin, seen.thumb
    vectors = np.zeros((6, 3))
    vectors[0], vectors[1] = seen.body.rotation[:, 0], seen.velocity_m_per_s
    vectors[2] = seen.spin_rad_per_s
    if skin:
        vectors[3], vectors[4] = skin.normal, skin.friction_n
    if thumb:
        vectors[5] = thumb.normal
    axis, velocity, spin, skin_normal, skin_friction, thumb_normal = seen.tip.turned(vectors)
    return {
        **own,
        "angles": seen.q_rad,
        "speeds": seen.dq_rad_per_s,
        "body": seen.tip.inside(seen.body.origin_m),
        "body_axis": axis,
        "velocity": velocity,
        "spin": spin,
        "position": seen.position_m,
        "skin_force": skin.force_n if skin else 0.0,
        "skin_normal": skin_normal,
        "skin_friction": skin_friction,
        "thumb_force": thumb.force_n if thumb else 0.0,
        "thumb_place": seen.thumb_tip.inside(np.array(thumb.point_m)) if thumb else np.zeros(3),
        "thumb_normal": thumb_normal,
        "held": float(seen.held),
    }


def _constant_names(values: Values) -> list[str]:
    return [
        path
        for path in values
        if not path.startswith("skin.effects.") and not any(word in path for word in _LEFT_OUT)
    ]
