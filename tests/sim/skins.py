"""Reference skins for the tests, and contacts as they come."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from sessions import exact

from skincal.robot import Kinematics, bundled_hand
from skincal.sim import ReferenceSkin, TrueContact, Truth

KINEMATICS = Kinematics(bundled_hand())


def contact(time_s: float, force_n: float, *, y_m: float = 0.0235, pose: float = 0.0) -> TrueContact:
    """A press of 2 mm/s and back, at beta = 0."""
    q = KINEMATICS.description.home_rad + pose
    gap = -force_n / 5e3
    return TrueContact(
        time_s, np.array([0, y_m, 0.0115]), np.array([0, 0, 1.0]), max(force_n, 0.0), 0.1, 0.2, gap, q
    )


def ramp(start_s: float = 0.0, y_m: float = 0.0235) -> list[TrueContact]:
    """Idle, load, hold and unload at 25 Hz."""
    forces = np.concatenate(
        [[-1.0] * 10, np.linspace(0, 4, 20), [4.0] * 20, np.linspace(4, 0, 20), [-1.0] * 10]
    )
    return [contact(start_s + 0.04 * i, float(f), y_m=y_m) for i, f in enumerate(forces)]


def skin(**strengths: float) -> ReferenceSkin:
    truth = exact(Truth.draw(np.random.default_rng(3), bundled_hand(), effects=strengths))
    return ReferenceSkin(KINEMATICS, replace(truth, noise_counts=0.0), np.random.default_rng(1))


def images(reference: ReferenceSkin, contacts: list[TrueContact]) -> np.ndarray:
    return np.array([reference.image(c) for c in contacts])
