"""Initial state of a scene, and frames in it."""

from __future__ import annotations

from dataclasses import dataclass

from skincal.envs.bodies import Body
from skincal.model.arrays import FloatArray
from skincal.sim.drives import DriveParameters


@dataclass(frozen=True, eq=False)
class Placed:
    """An object and where it is held.

    Attributes:
        body: the object.
        position_m: (3,) where its centre of mass is held [m].
        rotation: (3, 3) from its frame to the root's.
    """

    body: Body
    position_m: FloatArray
    rotation: FloatArray


@dataclass(frozen=True, eq=False)
class Grip:
    """Initial state of a scene.

    Attributes:
        angles_rad: (n,) angles of the links [rad].
        command_rad: (n,) what the drives hold to [rad].
        drives: what the drives are.
        objects: what is held: one object, or several.
        finger_friction: friction coefficient of the tips; that of a pair is the product.
        lateral_friction: the objects', against sliding.
        spinning_friction: the objects', against spinning about the normal [m].
        rolling_friction: the objects', against rolling [m].
        stiffness_n_per_m: spring constant of a contact [N/m].
        damping_ns_per_m: damping of a contact [N s/m].
    """

    angles_rad: FloatArray
    command_rad: FloatArray
    drives: DriveParameters
    objects: tuple[Placed, ...]
    finger_friction: float
    lateral_friction: float
    spinning_friction: float
    rolling_friction: float
    stiffness_n_per_m: float
    damping_ns_per_m: float


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame in the root's.

    Attributes:
        origin_m: (3,) [m].
        rotation: (3, 3).
    """

    origin_m: FloatArray
    rotation: FloatArray

    def inside(self, points_m: FloatArray) -> FloatArray:
        """Return points (..., 3) of the root's frame in this one."""
        return (points_m - self.origin_m) @ self.rotation

    def turned(self, vectors: FloatArray) -> FloatArray:
        """Return vectors (..., 3) of the root's frame in this one."""
        return vectors @ self.rotation
