"""Lookup of a hand by name or file, and the contact force inferred from its joints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from skincal.hand.driver import HandState
from skincal.robot import (
    DEFAULT_HAND,
    HandDescription,
    Kinematics,
    bundled_hand,
    contact_from_joints,
    read_hand,
)


def hand_named(hand: str | Path = DEFAULT_HAND) -> HandDescription:
    """Return the description of a hand: a bundled one by name, or a ``hand.toml``, or its folder.

    Raises:
        InputError: there is no hand of that name, or the file is invalid.
    """
    path = Path(hand).expanduser()
    return read_hand(path) if path.exists() or path.suffix or len(path.parts) > 1 else bundled_hand(str(hand))


def joint_contact_force(description: HandDescription) -> Callable[[HandState], float]:
    """Return a function that computes the size of the contact force [N] of a state from joint angles and torques.

    It is the full force, not only its normal part: a hand that presses sideways presses, too.
    """
    kinematics = Kinematics(description)

    def force_n(state: HandState) -> float:
        contact = contact_from_joints(kinematics, state.q_rad, state.tau_nm)
        parts = (contact.force_n[0], contact.shear_u_n[0], contact.shear_v_n[0])
        return float(sum(part * part for part in parts) ** 0.5)

    return force_n
