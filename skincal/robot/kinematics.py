"""Forward kinematics of both fingers, for many joint angles at once.

All positions are in the frame of the URDF's root link unless a name says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.dataset.findings import Findings
from skincal.dataset.model_objects import surface_of
from skincal.dataset.schema_errors import report
from skincal.errors import WorkError
from skincal.model import Surface
from skincal.model.arrays import FloatArray
from skincal.robot.chain import Chain, TipFrames
from skincal.robot.description import HandDescription
from skincal.robot.urdf import read_urdf


@dataclass(frozen=True, eq=False)
class ChainPair:
    """Two chains side by side; the shorter one is padded with joints that do nothing.

    Attributes:
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


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Forward kinematics of the two tips, and the surface of the one with the skin.

    Build it with ``Kinematics(description)``; the URDF is read once.

    Raises:
        InputError: the URDF is invalid, or contacts on such a surface cannot be found.
    """

    description: HandDescription
    skin: Chain = field(init=False, repr=False)
    indenter: Chain = field(init=False, repr=False)
    surface: Surface = field(init=False, repr=False)
    _pair: ChainPair = field(init=False, repr=False)

    def __post_init__(self) -> None:
        findings, meta = Findings(), self.description.meta
        urdf = read_urdf(self.description.urdf, findings)
        # A driver may bring a description that was read from no file.
        report(meta.hand_violations(), findings, f"hand {self.description.name}")
        findings.raise_errors()
        assert urdf is not None
        joints = self.description.joints
        skin = Chain.of(urdf, self.description.skin_finger, joints)
        indenter = Chain.of(urdf, self.description.indenter_finger, joints)
        object.__setattr__(self, "surface", surface_of(meta.surface, {}))
        object.__setattr__(self, "skin", skin)
        object.__setattr__(self, "indenter", indenter)
        object.__setattr__(self, "_pair", ChainPair.of(skin, indenter))

    def skin_frames(self, q_rad: ArrayLike) -> TipFrames:
        """Return the fingertip frames for joint angles (K, n) or (n,) [rad]."""
        return self.skin.frames(self.angles(q_rad))

    def indenter_frames(self, q_rad: ArrayLike) -> TipFrames:
        """Return the frames at the sphere's centre for joint angles (K, n) or (n,) [rad]."""
        return self.indenter.frames(self.angles(q_rad))

    def frames(self, q_rad: ArrayLike) -> tuple[TipFrames, TipFrames]:
        """Return the frames of the fingertip and at the sphere's centre for joint angles (K, n) or (n,) [rad]."""
        return self._pair.frames(self.angles(q_rad))

    def link_angles(self, q_rad: ArrayLike, tau_nm: ArrayLike) -> FloatArray:
        """Return the link angles (K, n) [rad]: measured angles (K, n) less the give of the drives at torques (K, n)."""
        q = self.angles(q_rad)
        give = self.description.compliance_rad_per_nm
        return q if give is None else q - give * self.angles(tau_nm)

    def torques(
        self,
        skin: TipFrames,
        indenter: TipFrames,
        on_skin_m: FloatArray,
        on_indenter_m: FloatArray,
        forces_n: FloatArray,
    ) -> FloatArray:
        """Return the torques at rest of all joints with which the fingers press on each other, (n,) or (n, F) [N m].

        Args:
            skin: frames of the fingertip, for one posture.
            indenter: frames of the other tip.
            on_skin_m: (1, 3) where the finger with the skin is pressed [m].
            on_indenter_m: (1, 3) where the other finger presses [m].
            forces_n: (3,) or (3, F) forces on the skin; like the points in the frame of the URDF's root [N].
        """
        tau = np.zeros((len(self.description.joints), *forces_n.shape[1:]))
        tau[self.indenter.columns] = self.indenter.jacobian(indenter, on_indenter_m)[0].T @ forces_n
        tau[self.skin.columns] = -self.skin.jacobian(skin, on_skin_m)[0].T @ forces_n
        return tau

    def angles(self, values: ArrayLike) -> FloatArray:
        """Return values (K, n) or (n,) as (K, n).

        Raises:
            ValueError: another number of joints.
        """
        rows = np.atleast_2d(np.asarray(values, dtype=np.float64))
        count = len(self.description.joints)
        if rows.ndim != 2 or rows.shape[1] != count:
            raise ValueError(f"expected values of {count} joints; got shape {np.shape(values)}")
        return rows


TOLERANCE_M = 1e-7
"""Largest distance of the centre from its target [m]."""
_ROUNDS = 100
_DAMPING = 1e-4
"""Damping, relative to the mean eigenvalue of J J^T: it keeps steps short near a singular posture."""
_LONGEST_RAD = 0.2
"""Largest change of a joint per iteration [rad]."""


def place_indenter(kinematics: Kinematics, centre_m: ArrayLike, q_rad: ArrayLike) -> FloatArray:
    """Return the joint angles (n,) [rad] at which the sphere's centre lies at a point of the fingertip frame.

    Damped Newton steps, clipped to the joint limits. The finger with the skin stays where it is.

    Args:
        kinematics: the hand.
        centre_m: (3,) target of the centre, fingertip frame [m].
        q_rad: (n,) angles of the links to start from [rad]; those of the skin's finger stay.

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
