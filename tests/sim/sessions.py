"""A simulated hand for the tests and simple ways to move it; reference skins, and contacts as they come."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skincal.robot import HandDescription, Kinematics, bundled_hand, place_indenter
from skincal.sim import JointTruth, ReferenceSkin, SimOptions, SimulatedHand, TrueContact, Truth

FloatArray = NDArray[np.float64]


def exact(truth: Truth) -> Truth:
    """The same truth with sensors that do not err, drives as the description says, and no friction or noise."""
    joints = truth.joints
    none = np.zeros_like(joints.offset_rad)
    perfect = JointTruth(
        offset_rad=none,
        wave_rad=none,
        wave_length_rad=joints.wave_length_rad,
        wave_phase_rad=none,
        noise_rad=0.0,
        speed_noise_rad_per_s=0.0,
        torque_offset_nm=none,
        torque_scale=none + 1,
        torque_noise_nm=0.0,
        drive_stiffness_nm_per_rad=none + 25.0,
        friction_nm=none,
    )
    return replace(truth, joints=perfect, noise_counts=0.0)


@contextmanager
def session(
    seed: int = 1,
    *,
    description: HandDescription | None = None,
    perfect: bool = False,
    options: SimOptions | None = None,
) -> Iterator[SimulatedHand]:
    description = description or bundled_hand()
    truth = Truth.draw(np.random.default_rng(seed), description)
    hand = SimulatedHand(
        description, exact(truth) if perfect else truth, np.random.default_rng(seed + 100), options
    )
    try:
        yield hand
    finally:
        hand.close()


def move(hand: SimulatedHand, q_rad: FloatArray, time_s: float) -> None:
    """Moves the commanded angles evenly to a goal."""
    start = hand.reading().q_desired_rad
    count = max(1, round(time_s * 100))
    for i in range(count):
        hand.command(start + (q_rad - start) * (i + 1) / count)
        hand.advance(10)


def pressed(description: HandDescription, depth_m: float, y_m: float | None = None) -> FloatArray:
    """Angles at which the sphere would stand this deep in the skin at its nominal centre, if it did not resist."""
    meta = description.meta
    radius = (meta.surface.radius_m or 0.0) + (meta.indenter.radius_m or 0.0)
    target = [0.0, meta.mount.y_m if y_m is None else y_m, radius - depth_m]
    return place_indenter(Kinematics(description), target, description.home_rad)


def press(hand: SimulatedHand, depth_m: float = 0.01) -> None:
    """Approaches and presses, and waits until it is at rest."""
    move(hand, pressed(hand.description, -0.002), 0.8)
    move(hand, pressed(hand.description, depth_m), 0.6)
    hand.advance(600)


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
