"""What a tip feels of an object: all contact points that the physics reports, made one."""

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
    """All contact points of a tip with the object as one, weighted by their normal forces.

    So the result does not depend on how many points carry the same force. PyBullet now and then gives a force, a place
    or a normal that is NaN, infinite or absurd (bullet3 #4232): such a point is left out.

    Args:
        points: of the tip.
        largest_n: forces beyond this are not believed [N].

    Returns:
        The contact; None where no point carries a force.
    """
    total, count = 0.0, 0
    place, normal, friction = [0.0] * 3, [0.0] * 3, [0.0] * 3
    for point in points:
        if not _sound(point, largest_n):
            continue
        force = point.force_n
        total += force
        count += 1
        for i in range(3):
            place[i] += force * point.place_m[i]
            normal[i] += force * point.normal[i]
            friction[i] += point.friction_n[i]
    length = math.sqrt(sum(v * v for v in normal))
    if not total > 0 or not length > 0:
        return None
    return Touching(
        (place[0] / total, place[1] / total, place[2] / total),
        (normal[0] / length, normal[1] / length, normal[2] / length),
        total,
        (friction[0], friction[1], friction[2]),
        count,
    )


def _sound(point: Point, largest_n: float) -> bool:
    """Return whether a point carries a force that can be believed; a comparison with NaN is false."""
    x, y, z = point.normal
    finite = all(map(math.isfinite, (*point.place_m, *point.friction_n)))
    unit = abs(x * x + y * y + z * z - 1.0) <= 2e-3
    return (
        0.0 < point.force_n <= largest_n
        and unit
        and finite
        and max(map(abs, point.friction_n)) <= 4 * largest_n
    )
