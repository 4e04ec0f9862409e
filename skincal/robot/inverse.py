"""Inverse kinematics of the indenter: joint angles that put the sphere's centre at a given point."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from skincal.errors import WorkError
from skincal.model.arrays import FloatArray
from skincal.robot.kinematics import Kinematics

TOLERANCE_M = 1e-7
"""Largest distance of the centre from its target [m]."""
_ROUNDS = 100
_DAMPING = 1e-4
"""Damping, relative to the mean eigenvalue of J J^T: it keeps steps short near a singular posture."""
_LONGEST_RAD = 0.2
"""Largest change of a joint per iteration [rad]."""


def place_indenter(kinematics: Kinematics, centre_m: ArrayLike, q_rad: ArrayLike) -> FloatArray:
    """Return the joint angles at which the sphere's centre lies at a point of the fingertip frame.

    Damped Newton steps, clipped to the joint limits. The finger with the skin stays where it is.

    Args:
        kinematics: the hand.
        centre_m: (3,) target of the centre, fingertip frame [m].
        q_rad: (n,) angles of the links to start from [rad]; those of the skin's finger stay.

    Returns:
        (n,) angles of the links [rad].

    Raises:
        WorkError: the point is out of reach within the joint limits.
    """
    limits = kinematics.description.limits
    target = np.asarray(centre_m, dtype=np.float64).reshape(3)
    q = np.array(q_rad, dtype=np.float64).reshape(-1)
    columns = kinematics.indenter.columns
    low, high = limits.lower_rad[columns], limits.upper_rad[columns]
    goal = kinematics.skin_frames(q).to_root(target[None])
    best = np.inf
    for _ in range(_ROUNDS):
        frames = kinematics.indenter_frames(q)
        error = (goal - frames.origins_m)[0]
        best = min(best, float(np.linalg.norm(error)))
        if best <= TOLERANCE_M:
            return q
        jacobian = kinematics.indenter.jacobian(frames, frames.origins_m)[0]
        q[columns] = np.clip(q[columns] + _step(jacobian, error, q[columns], low, high), low, high)
    place = ", ".join(f"{1e3 * v:.1f}" for v in target)
    raise WorkError(
        f"inverse kinematics: expected a point that {kinematics.description.indenter_finger.name} can reach; got "
        f"({place}) mm in the fingertip frame, which it misses by {1e3 * best:.2f} mm within its joint limits. "
        "Choose another pose of the finger with the skin."
    )


def _step(
    jacobian: FloatArray, error: FloatArray, q: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return a damped step (J,) towards an error (3,), without the joints that would leave their limits."""
    step = _damped(jacobian, error)
    held = ((q <= low) & (step < 0)) | ((q >= high) & (step > 0))
    if held.any() and not held.all():
        step = _damped(jacobian * ~held, error)
    return step * min(1.0, _LONGEST_RAD / max(float(np.abs(step).max()), 1e-12))


def _damped(jacobian: FloatArray, error: FloatArray) -> FloatArray:
    square = jacobian @ jacobian.T
    # The damping fades with the error, so that the last iterations are plain Newton steps.
    fade = min(1.0, float(np.linalg.norm(error)) / 1e-3)
    damping = _DAMPING * (fade + 1e-6) * float(np.trace(square)) / 3
    return jacobian.T @ np.linalg.solve(square + damping * np.eye(3), error)
