"""The kinematic chain of one finger: from joint angles to the frame of its tip and the Jacobian of a point on it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.model.arrays import FloatArray
from skincal.robot.description import FingerDescription
from skincal.robot.urdf import Urdf, UrdfJoint


@dataclass(frozen=True, eq=False)
class TipFrames:
    """Frames of a tip link for K sets of joint angles, and the axes that move it.

    Attributes:
        rotations: (K, 3, 3) from the tip's frame to the root's.
        origins_m: (K, 3) origins of the tip's frame [m].
        axes: (K, J, 3) unit axes of the finger's J joints.
        pivots_m: (K, J, 3) a point on each axis [m].
    """

    rotations: FloatArray
    origins_m: FloatArray
    axes: FloatArray
    pivots_m: FloatArray

    def to_tip(self, points_m: FloatArray) -> FloatArray:
        """Transform points (K, 3) from the root's frame to the tip's frame."""
        return ((points_m - self.origins_m)[:, None] @ self.rotations)[:, 0]

    def to_root(self, points_m: FloatArray) -> FloatArray:
        """Transform points (K, 3) from the tip's frame to the root's frame."""
        return self.origins_m + (self.rotations @ points_m[..., None])[..., 0]


@dataclass(frozen=True, eq=False)
class Chain:
    """A finger's joints from the root to its tip link, with fixed joints merged into them.

    A revolute joint rotates by R(q) = constant + sin q * sine + cos q * cosine (Rodrigues' formula, premultiplied by
    the fixed rotation before it).

    Attributes:
        columns: (J,) indices of the finger's joints among all joints of the hand.
        steps_m: (J, 3) from joint to joint, in the frame before the joint moves [m].
        constant: (J, 3, 3).
        sine: (J, 3, 3).
        cosine: (J, 3, 3).
        axes: (J, 3) axes in the frame before the joint moves.
        slides: (J,) True where the joint is prismatic.
        end_rotation: (3, 3) from the tip's frame to that of the last joint.
        end_m: (3,) origin of the tip's frame in that of the last joint [m].
    """

    columns: NDArray[np.int64]
    steps_m: FloatArray
    constant: FloatArray
    sine: FloatArray
    cosine: FloatArray
    axes: FloatArray
    slides: NDArray[np.bool_]
    end_rotation: FloatArray
    end_m: FloatArray

    @classmethod
    def of(cls, urdf: Urdf, finger: FingerDescription, joints: tuple[str, ...]) -> Chain:
        """Return the chain of a finger whose joints have been checked."""
        rotation, origin = np.eye(3), np.zeros(3)
        steps: list[FloatArray] = []
        turns: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        axes: list[FloatArray] = []
        slides: list[bool] = []
        for joint in urdf.chain(finger.tip_link):
            origin = origin + rotation @ joint.origin_m
            rotation = rotation @ joint.rotation
            if joint.name not in finger.joints:
                continue
            steps.append(origin)
            axes.append(rotation @ joint.axis)
            turns.append(_turn(rotation, joint))
            slides.append(joint.kind == "prismatic")
            rotation, origin = np.eye(3), np.zeros(3)
        columns = np.array([joints.index(name) for name in finger.joints], dtype=np.int64)
        constant, sine, cosine = (np.array(part) for part in zip(*turns, strict=True))
        return cls(columns, np.array(steps), constant, sine, cosine, np.array(axes), np.array(slides), rotation,
                   origin)  # fmt: skip

    @cached_property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """The attributes in their order, for ``skincal.robot.routine``."""
        return tuple(getattr(self, one.name) for one in fields(self))

    def frames(self, q_rad: FloatArray) -> TipFrames:
        """Return the frames of the tip for joint angles (K, n) of the whole hand [rad]."""
        from skincal.robot.routine import compiled

        count, joints = len(q_rad), len(self.columns)
        frames = (
            np.empty((count, 3, 3)),
            np.empty((count, 3)),
            np.empty((count, joints, 3)),
            np.empty((count, joints, 3)),
        )
        compiled().tip_frames(q_rad, self.arrays, *frames)
        return TipFrames(*frames)

    def jacobian(self, frames: TipFrames, points_m: FloatArray) -> FloatArray:
        """Return the velocity of points (K, 3) fixed to the tip link per joint velocity, (K, 3, J) [m/rad]."""
        arm = points_m[:, None] - frames.pivots_m
        columns = np.where(self.slides[:, None], frames.axes, np.cross(frames.axes, arm))
        return np.swapaxes(columns, 1, 2)


def _turn(before: FloatArray, joint: UrdfJoint) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the constant, sine and cosine part (3, 3) of a joint's rotation after a fixed rotation."""
    if joint.kind == "prismatic":
        return before, np.zeros((3, 3)), np.zeros((3, 3))
    x, y, z = joint.axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    along = np.outer(joint.axis, joint.axis)
    return before @ along, before @ skew, before @ (np.eye(3) - along)
