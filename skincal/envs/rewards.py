"""Shapes and terms of the reward (Kasolowsky & Bäuml, IROS 2024, section IV-B)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skincal.errors import check_options


def falling(x: float, width: float) -> float:
    """Return the reward of a deviation: 1 at zero, falling along a cosine to 0 at a width and beyond.

    The paper prints rew(x; width) with its outer cases exchanged, which would reward the largest deviation most.
    """
    if x <= 0:
        return 1.0
    return 0.0 if x >= width else 0.5 * (1 + math.cos(math.pi * x / width))


@dataclass(frozen=True)
class RewardScales:
    """Weights and widths of all terms; the weights and the first three widths are the paper's.

    Attributes:
        position: weight of the distance between contact and target.
        grasp: weight of touching with the right parts of the fingers.
        force: weight of the normal force.
        angle: weight of the bolt's angle; the marble has none.
        joint: weight of the penalty at joint limits.
        speed: weight of the penalty at limits of joint velocity.
        torque: weight of the penalty at limits of torque.
        position_width_m: distance without reward [m].
        force_n: force with the highest reward [N].
        force_width_n: deviation without reward [N].
        angle_width_rad: angle without reward [rad].
        joint_margin_rad: soft margin before the joint limits [rad]; assumed.
        speed_margin: soft margin, in parts of the largest velocity; assumed.
        torque_margin: soft margin, in parts of the largest torque; assumed.
    """

    position: float = 0.15
    grasp: float = 0.05
    force: float = 0.05
    angle: float = 0.05
    joint: float = 0.01
    speed: float = 0.01
    torque: float = 0.01
    position_width_m: float = 5e-3
    force_n: float = 1.5
    force_width_n: float = 1.5
    angle_width_rad: float = math.radians(15.0)
    joint_margin_rad: float = math.radians(5.0)
    speed_margin: float = 0.2
    torque_margin: float = 0.2

    def __post_init__(self) -> None:
        check_options(self, "a finite number, 0 or more", lambda value: 0 <= value < math.inf)


def reward_terms(
    scales: RewardScales,
    *,
    distance_m: float,
    force_n: float,
    right_contact: bool,
    past_joint_rad: float,
    past_speed: float,
    past_torque: float,
    angle_rad: float | None = None,
) -> dict[str, float]:
    """Return all terms of a step's reward, penalties negative; the reward is their sum.

    Args:
        scales: weights and widths.
        distance_m: from the contact to the target, on the skin [m]; inf without contact.
        force_n: normal force on the skin [N].
        right_contact: the tip of the thumb and the cylindrical part of the other finger touch.
        past_joint_rad: how far the worst joint is beyond its soft margin [rad]; negative before it.
        past_speed: the same for velocities, in parts of the largest.
        past_torque: the same for torques, in parts of the largest.
        angle_rad: by how much a bolt has turned [rad]; None: it has no angle to keep.
    """
    terms = {
        "position": scales.position * falling(distance_m, scales.position_width_m),
        "force": scales.force * falling(abs(force_n - scales.force_n), scales.force_width_n),
        "grasp": scales.grasp * float(right_contact),
    }
    if angle_rad is not None:
        terms["angle"] = scales.angle * falling(abs(angle_rad), scales.angle_width_rad)
    terms["joint"] = -scales.joint * penalty(past_joint_rad, scales.joint_margin_rad)
    terms["speed"] = -scales.speed * penalty(past_speed, scales.speed_margin)
    terms["torque"] = -scales.torque * penalty(past_torque, scales.torque_margin)
    return terms


def penalty(x: float, margin: float) -> float:
    """Return the paper's pen(x; margin) for being x beyond the start of a soft margin: 1 at its end, the hard limit."""
    return 1.0 - falling(x, margin) if margin > 0 else float(x > 0)
