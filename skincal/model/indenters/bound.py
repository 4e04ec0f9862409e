"""Where an indenter can be at most: spares rays at points that cannot be touched."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import FloatArray, IntArray

_LOST = 1e-6
"""Shorter than this, what lies across a direction has none itself."""


@dataclass(frozen=True, eq=False)
class Bound:
    """Paraboloids behind which an indenter lies, for each of K directions. It never changes a result.

    All lengths are counted from ``axis_m``. No point of the indenter that lies by r beside the axis is nearer along
    the direction than ``nearest_m`` + ``bend_per_m`` r², and none lies beside it by more than ``reach_m``. This holds
    for r in each of the columns: the distance from the axis and, if there are three, the parts of it along the two
    sides of ``frame``.

    Attributes:
        axis_m: (K, 3) a point of the axis [m].
        frame: (K, 3, 3) unit vectors as rows: two sides, and the direction.
        nearest_m: (K,) [m].
        bend_per_m: (K, 1) or (K, 3) zero or more [1/m].
        reach_m: (K, 1) or (K, 3) [m].
    """

    axis_m: FloatArray
    frame: FloatArray
    nearest_m: FloatArray
    bend_per_m: FloatArray
    reach_m: FloatArray

    def __getitem__(self, rows: slice | IntArray) -> Bound:
        """The bounds of some directions."""
        return Bound(
            self.axis_m[rows],
            self.frame[rows],
            self.nearest_m[rows],
            self.bend_per_m[rows],
            self.reach_m[rows],
        )

    def moved(self, rotations: FloatArray, origins_m: FloatArray) -> Bound:
        """The same in another frame: turned by rotations (K, 3, 3), then moved to origins (K, 3) [m]."""
        axis = (rotations @ self.axis_m[:, :, None])[..., 0] + origins_m
        frame = self.frame @ np.swapaxes(rotations, 1, 2)
        return Bound(axis, frame, self.nearest_m, self.bend_per_m, self.reach_m)

    def place(self, points_m: FloatArray) -> FloatArray:
        """Coordinates (K, 3, N) [m] about the axis, along the frame, of points (3, N) or (K, 3, N)."""
        place = self.frame @ points_m
        place -= self.frame @ self.axis_m[:, :, None]
        return place

    def distance(
        self, place_m: FloatArray, slack_m: FloatArray | None = None, along_m: FloatArray | None = None
    ) -> FloatArray:
        """Distances along the direction below which the indenter is not met.

        Args:
            place_m: (K, 3, N) what :meth:`place` says of points.
            slack_m: (N,) radii of balls round the points [m], if the whole balls are meant.
            along_m: (K, N) how far of the balls is meant along the direction [m]; all of them where it is left out.

        Returns:
            (K, N) [m]; inf where it cannot be met at all.
        """
        sides_2 = place_m[:, :2] ** 2
        aside_2 = sides_2[:, :1] + sides_2[:, 1:]
        if self.bend_per_m.shape[1] > 1:
            aside_2 = np.concatenate([aside_2, sides_2], axis=1)
        distance = self.nearest_m[:, None] - place_m[:, 2]
        if slack_m is not None:
            distance -= slack_m if along_m is None else along_m
            aside_2 = np.maximum(np.sqrt(aside_2) - slack_m, 0.0) ** 2
        outside = aside_2 > self.reach_m[:, :, None] ** 2
        aside_2 *= self.bend_per_m[:, :, None]
        single = aside_2.shape[1] == 1
        distance += aside_2[:, 0] if single else aside_2.max(axis=1)
        distance[outside[:, 0] if single else outside.any(axis=1)] = np.inf
        return distance


def frames(directions: FloatArray, side: tuple[float, float, float] | FloatArray) -> FloatArray:
    """Frames (K, 3, 3) for directions (K, 3): rows are two sides and the direction.

    The first side is the part of ``side`` across the direction; any across it where nothing is left of ``side``.
    """
    if len(directions) == 1:
        found = _one_frame(directions[0].tolist(), np.asarray(side).tolist())
        if found is not None:
            return found
    across = side - (directions @ np.asarray(side))[:, None] * directions
    length = np.sqrt(np.einsum("ki,ki->k", across, across))
    lost = length < _LOST
    if lost.any():
        least = np.eye(3)[np.argmin(np.abs(directions[lost]), axis=1)]
        across[lost] = np.cross(directions[lost], least)
        length[lost] = np.linalg.norm(across[lost], axis=1)
    across /= length[:, None]
    x, y = directions.T, across.T
    other = np.stack([x[i] * y[j] - x[j] * y[i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)
    return np.stack([across, other, directions], axis=1)


def _one_frame(z: list[float], side: list[float]) -> FloatArray | None:
    """One of the frames, with plain numbers, numpy being slower for three; None where nothing is left of the side."""
    along = sum(a * b for a, b in zip(z, side, strict=True))
    x = [b - along * a for a, b in zip(z, side, strict=True)]
    length = math.hypot(*x)
    if not length >= _LOST:
        return None
    x = [a / length for a in x]
    y = [z[i] * x[j] - z[j] * x[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    return np.array([[x, y, z]])
