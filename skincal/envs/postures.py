"""Postures of a pinch: joint angles at which the two tips face each other with a given distance between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.envs.pinch import Pinch
from skincal.errors import WorkError
from skincal.model.arrays import FloatArray
from skincal.robot import Chain, TipFrames

_WIDTHS_M = np.arange(-0.024, 0.0441, 0.002)
_ROUNDS = 40
_NEAR_M = 1e-9


@dataclass(frozen=True, eq=False)
class Postures:
    """Postures over the distance between the tips; between those that are worked out, angles go evenly.

    Where the distance is below an object's size, the angles are commands that squeeze it.

    Attributes:
        widths_m: (W,) distances, ascending [m].
        angles_rad: (W, n) [rad].
        middle_m: (3,) the point halfway between the tips, the same for all, frame of the URDF's root [m].
    """

    widths_m: FloatArray
    angles_rad: FloatArray
    middle_m: FloatArray

    @classmethod
    def of(cls, pinch: Pinch) -> Postures:
        """Work out the postures about that of the description.

        The finger with the skin faces the middle with the sensor's nominal centre; the centre of the thumb's round end
        lies beyond the middle, along the normal there.

        Raises:
            WorkError: the fingers cannot reach them.
        """
        kinematics = pinch.kinematics
        out, foot, end = pinch.facing
        skin, thumb = kinematics.frames(pinch.angles_rad)
        normal = skin.rotations[0] @ out
        middle = (skin.to_root(foot)[0] + thumb.to_root(end)[0] - pinch.thumb.radius_m * normal) / 2
        rows: list[FloatArray] = []
        start = int(np.argmin(np.abs(_WIDTHS_M - 0.012)))
        for part in (_WIDTHS_M[start:], _WIDTHS_M[:start][::-1]):
            q = pinch.angles_rad.copy()
            found: list[FloatArray] = []
            for width in part:
                q = _reach(kinematics.skin, q, foot[0] + width / 2 * out, middle)
                face = kinematics.skin_frames(q).rotations[0] @ out
                target = middle + (width / 2 + pinch.thumb.radius_m) * face
                q = _reach(kinematics.indenter, q, end[0], target)
                found.append(q)
            rows = rows + found if not rows else found[::-1] + rows
        limits = pinch.description.limits
        angles = np.clip(np.array(rows), limits.lower_rad, limits.upper_rad)
        return cls(_WIDTHS_M, angles, middle)

    def at(self, width_m: float) -> FloatArray:
        """Return angles (n,) at a distance between the tips [m]; at most those of the ends of the table."""
        place = np.clip(np.interp(width_m, self.widths_m, np.arange(len(self.widths_m))), 0, None)
        low = min(int(place), len(self.widths_m) - 2)
        part = place - low
        return (1 - part) * self.angles_rad[low] + part * self.angles_rad[low + 1]


def _reach(chain: Chain, q_rad: FloatArray, point_m: FloatArray, target_m: FloatArray) -> FloatArray:
    """Return angles at which a point of a tip's frame lies at a target of the root's frame: Newton's steps."""
    q = q_rad.copy()
    for _ in range(_ROUNDS):
        frames: TipFrames = chain.frames(q[None])
        at = frames.to_root(point_m[None])
        error = target_m - at[0]
        if np.linalg.norm(error) < _NEAR_M:
            return q
        step = _step(chain.jacobian(frames, at)[0], error)
        q[chain.columns] += step * min(1.0, 0.2 / max(float(np.abs(step).max()), 1e-12))
    place = ", ".join(f"{1e3 * v:.1f}" for v in target_m)
    raise WorkError(
        f"pinch grasp: expected a posture from which the tips can close and open; got one that does not reach "
        f"({place}) mm. Choose other angles_deg in pinch.toml."
    )


def _step(jacobian: FloatArray, error: FloatArray) -> FloatArray:
    """Return the shortest step (J,) towards an error (3,)."""
    square = jacobian @ jacobian.T
    return jacobian.T @ np.linalg.solve(square + 1e-12 * np.eye(3), error)
