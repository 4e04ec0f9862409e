"""Input and output of a scene: the grip at its start, frames, and contacts of the tips."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from skincal.envs.bodies import Body
from skincal.model.arrays import FloatArray
from skincal.sim.drives import DriveParameters


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
