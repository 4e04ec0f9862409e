"""Forward kinematics of both fingers in one pass; for a single posture it takes little more than one finger."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.model.arrays import FloatArray
from skincal.robot.chain import Chain, TipFrames


@dataclass(frozen=True, eq=False)
class ChainPair:
    """Two chains side by side; the shorter one is padded with joints that do nothing.

    Attributes:
        counts: number of joints of each.
        columns: (2, J) indices of the joints among all joints of the hand.
        steps_m: (J, 2, 3, 1) from joint to joint [m].
        constant: (2, J, 3, 3) rotation = constant + sin q * sine + cos q * cosine, as are the next two.
        sine: (2, J, 3, 3).
        cosine: (2, J, 3, 3).
        axes: (J, 2, 3, 1) axes, before the joint moves.
        slides: (2, J) 1 where the joint is prismatic, else 0.
        end_rotation: (2, 3, 3) from the tip's frame to that of the last joint.
        end_m: (2, 3, 1) origin of the tip's frame in that of the last joint [m].
    """

    counts: tuple[int, int]
    columns: NDArray[np.int64]
    steps_m: FloatArray
    constant: FloatArray
    sine: FloatArray
    cosine: FloatArray
    axes: FloatArray
    slides: FloatArray
    end_rotation: FloatArray
    end_m: FloatArray

    @classmethod
    def of(cls, first: Chain, second: Chain) -> ChainPair:
        """Return the pair of two chains."""
        both = (first, second)
        length = max(len(chain.columns) for chain in both)

        def filled(name: str, still: FloatArray | float) -> FloatArray:
            out = np.empty((2, length, *np.shape(still)))
            out[:] = still
            for i, chain in enumerate(both):
                out[i, : len(chain.columns)] = getattr(chain, name)
            return out

        def by_joint(vectors: FloatArray) -> FloatArray:
            return np.swapaxes(vectors, 0, 1)[..., None].copy()

        return cls(
            counts=(len(first.columns), len(second.columns)),
            columns=filled("columns", 0).astype(np.int64),
            steps_m=by_joint(filled("steps_m", np.zeros(3))),
            constant=filled("constant", np.eye(3)),
            sine=filled("sine", np.zeros((3, 3))),
            cosine=filled("cosine", np.zeros((3, 3))),
            axes=by_joint(filled("axes", np.zeros(3))),
            slides=filled("slides", 0.0),
            end_rotation=np.stack([chain.end_rotation for chain in both]),
            end_m=np.stack([chain.end_m for chain in both])[..., None],
        )

    def frames(self, q_rad: FloatArray) -> tuple[TipFrames, TipFrames]:
        """Return the frames of both tips for joint angles (K, n) of the whole hand [rad]."""
        q = q_rad[:, self.columns]
        turns = (
            self.constant + np.sin(q)[..., None, None] * self.sine + np.cos(q)[..., None, None] * self.cosine
        )
        moves = q * self.slides if self.slides.any() else None
        count, _, length = q.shape
        axes, pivots = np.empty((count, length, 2, 3, 1)), np.empty((count, length, 2, 3, 1))
        # Nothing is rotated before the first joint.
        rotation, origin = np.broadcast_to(np.eye(3), (count, 2, 3, 3)), np.zeros((count, 2, 3, 1))
        for j in range(length):
            step = self.steps_m[j]
            if moves is not None:
                step = step + moves[:, :, j, None, None] * self.axes[j]
            origin = origin + rotation @ step
            axes[:, j], pivots[:, j] = rotation @ self.axes[j], origin
            rotation = rotation @ turns[:, :, j]
        rotations, origins = rotation @ self.end_rotation, origin + rotation @ self.end_m
        return (
            self._frames(0, rotations, origins, axes, pivots),
            self._frames(1, rotations, origins, axes, pivots),
        )

    def _frames(
        self, i: int, rotations: FloatArray, origins: FloatArray, axes: FloatArray, pivots: FloatArray
    ) -> TipFrames:
        joints = self.counts[i]
        return TipFrames(
            rotations[:, i], origins[:, i, :, 0], axes[:, :joints, i, :, 0], pivots[:, :joints, i, :, 0]
        )
