"""Interface of a physics engine to the tasks: two fingers and one object or several, and what goes in and out."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from skincal.envs.bodies import Body
from skincal.envs.pinch import Pinch
from skincal.errors import input_error
from skincal.model.arrays import FloatArray
from skincal.sim.drives import DriveParameters, Drives
from skincal.tasks import Engine

PHYSICS_HZ = 1000
"""Steps of physics and controller (the paper's) [Hz]."""
LARGEST_FORCE_N = 200.0
"""Contact forces beyond this are artefacts of the solver and are ignored [N]; the drives can exert some 20 N."""
_LARGEST_ANGLE_RAD = 1e2
"""A norm of all joint angles beyond this is absurd [rad]."""
_FAR_M = 10.0
"""An object beyond this is absurdly far [m]."""


@dataclass(frozen=True, eq=False)
class Placed:
    """An object and where it is held.

    Attributes:
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
        angles_rad: (n,) angles of the links, to which the drives hold [rad].
        objects: what is held: one object, or several.
        finger_friction: friction coefficient of the tips; that of a pair is the product.
        lateral_friction: the objects', against sliding.
        spinning_friction: the objects', against spinning about the normal [m].
        rolling_friction: the objects', against rolling [m].
        stiffness_n_per_m: spring constant of a contact [N/m].
    """

    angles_rad: FloatArray
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


Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Touching:
    """One contact of a tip with the object, frame of the URDF's root.

    Attributes:
        point_m: centre of the normal force, on the tip [m].
        normal: unit normal, out of the tip and into the object.
        force_n: normal force; all points together [N].
        friction_n: tangential force on the tip [N].
        points: how many contact points it was made of.
    """

    point_m: Vector
    normal: Vector
    force_n: float
    friction_n: Vector
    points: int


class Point(NamedTuple):
    """A contact point on a tip, frame of the URDF's root.

    Attributes:
        normal: unit normal, out of the tip and into the object.
        friction_n: tangential force on the tip [N].
    """

    place_m: Vector
    normal: Vector
    force_n: float
    friction_n: Vector


def merged(points: Sequence[Point], largest_n: float) -> Touching | None:
    """Return all contact points of a tip as one, weighted by their normal forces; None where no point carries any.

    So the result does not depend on how many points carry the same force. PyBullet now and then gives a force, a place
    or a normal that is NaN, infinite or absurd (bullet3 #4232): such a point is left out.
    """
    total, count = 0.0, 0
    x = y = z = nx = ny = nz = fx = fy = fz = 0.0
    for point in points:
        if not _sound(point, largest_n):
            continue
        place, normal, force, friction = point
        total += force
        count += 1
        x, y, z = x + force * place[0], y + force * place[1], z + force * place[2]
        nx, ny, nz = nx + force * normal[0], ny + force * normal[1], nz + force * normal[2]
        fx, fy, fz = fx + friction[0], fy + friction[1], fz + friction[2]
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if not total > 0 or not length > 0:
        return None
    place = (x / total, y / total, z / total)
    return Touching(place, (nx / length, ny / length, nz / length), total, (fx, fy, fz), count)


def _sound(point: Point, largest_n: float) -> bool:
    """Return whether a point carries a force that can be believed; a comparison with NaN is false."""
    (x, y, z), (nx, ny, nz), force, (fx, fy, fz) = point
    most = 4 * largest_n
    return (
        0.0 < force <= largest_n
        and abs(nx * nx + ny * ny + nz * nz - 1.0) <= 2e-3
        and math.isfinite(x + y + z)
        and -most <= fx <= most
        and -most <= fy <= most
        and -most <= fz <= most
    )


class Scene(ABC):
    """Two fingers and the objects they hold in one engine; nothing is shared between scenes or processes.

    Attributes:
        drives: of the joints; their targets are set from outside.
        force_n: acts on each object's centre all the time, frame of the URDF's root (3,) [N].
        held: whether the objects are still held in place.
    """

    drives: Drives
    force_n: list[float]
    held: bool = False

    @abstractmethod
    def begin(self, grip: Grip) -> None:
        """Build the world anew, so that nothing of an earlier episode is left; objects are held in place."""

    @abstractmethod
    def release(self) -> None:
        """Let go of all objects."""

    @abstractmethod
    def run(self, steps: int) -> None:
        """Move on by some physics steps."""

    @abstractmethod
    def touches(self, which: int | None = None) -> tuple[Touching | None, Touching | None]:
        """Return the contacts of the tip with the skin and of the thumb with one object; None: with all of them."""

    @abstractmethod
    def joints(self) -> tuple[FloatArray, FloatArray]:
        """Return angles [rad] and velocities [rad/s] of the links (n,)."""

    @abstractmethod
    def tips(self) -> tuple[Frame, Frame]:
        """Return the frames of the tip with the skin and of the thumb's."""

    @abstractmethod
    def object_frame(self, which: int = 0) -> Frame:
        """Return the frame of an object."""

    @abstractmethod
    def object_motion(self, which: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return an object's velocity [m/s] and angular velocity [rad/s], each (3,)."""

    @abstractmethod
    def gap_m(self) -> float:
        """Return the smallest distance between a tip and an object [m], negative inside; at most 0.05 m."""

    @abstractmethod
    def close(self) -> None:
        """End it; may be called twice."""

    def _begin_drives(self, grip: Grip) -> None:
        self.drives = Drives(grip.drives, grip.angles_rad, 1.0 / PHYSICS_HZ)
        self.drives.target_rad = grip.angles_rad
        self.force_n = [0.0, 0.0, 0.0]


def make_scene(
    engine: str, pinch: Pinch, iterations: int, *, window: bool = False, visible: bool = False
) -> Scene:
    """Return a scene in an engine.

    Raises:
        InputError: the engine is not installed.
    """
    # Each engine is loaded where it is used.
    if engine == "mujoco":
        from skincal.envs.mujoco_scene import MujocoScene

        return MujocoScene(pinch)
    from skincal.envs.bullet_scene import BulletScene

    return BulletScene(pinch, iterations, window=window, visible=visible)


def check_engine(engine: str, place: str) -> None:
    """Check the name of an engine.

    Raises:
        InputError: there is no such engine.
    """
    if engine not in [*Engine]:
        raise input_error(place, " or ".join(Engine), repr(engine))


def sound(q_rad: FloatArray, dq_rad_per_s: FloatArray, place_m: FloatArray) -> bool:
    """Return whether angles and velocities of the joints and the object's place (3,) are finite and not absurd."""
    # A comparison with NaN is false.
    moves = float(dq_rad_per_s @ dq_rad_per_s) < math.inf
    there = float(place_m @ place_m) < _FAR_M**2
    return moves and there and float(q_rad @ q_rad) < _LARGEST_ANGLE_RAD**2
