"""Contact of a tip with an object: all contact points of the physics merged into one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

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
        place_m: on the tip [m].
        normal: unit normal, out of the tip and into the object.
        force_n: normal force [N].
        friction_n: tangential force on the tip [N].
    """

    place_m: Vector
    normal: Vector
    force_n: float
    friction_n: Vector


def merged(points: Sequence[Point], largest_n: float) -> Touching | None:
    """Return all contact points of a tip with the object as one, weighted by their normal forces.

    So the result does not depend on how many points carry the same force. PyBullet now and then gives a force, a place
    or a normal that is NaN, infinite or absurd (bullet3 #4232): such a point is left out.

    Args:
        points: of the tip.
        largest_n: forces beyond this are not believed [N].

    Returns:
        The contact; None where no point carries a force.
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
