"""What a tip feels of an object: all contact points that the physics reports, made one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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


def merged(rows: Sequence[Sequence[Any]], link: int, largest_n: float) -> Touching | None:
    """All contact points of a link with the object as one, weighted by their normal forces.

    So the result does not depend on how many points carry the same force. PyBullet now and then gives a force, a place
    or a normal that is NaN, infinite or absurd (bullet3 #4232): such a point is left out.

    Args:
        rows: of ``getContactPoints``, the fingers being the first body.
        link: index of the tip.
        largest_n: forces beyond this are not believed [N].

    Returns:
        The contact; None where no point carries a force.
    """
    total, count = 0.0, 0
    place, normal, friction = [0.0] * 3, [0.0] * 3, [0.0] * 3
    for row in rows:
        if row[3] != link or not _sound(row, largest_n):
            continue
        force = row[9]
        total += force
        count += 1
        for i in range(3):
            place[i] += force * row[5][i]
            # PyBullet's normal points at the first body.
            normal[i] -= force * row[7][i]
            friction[i] += row[10] * row[11][i] + row[12] * row[13][i]
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


def _sound(row: Sequence[Any], largest_n: float) -> bool:
    """Whether a point carries a force that can be believed; a comparison with NaN is false."""
    x, y, z = row[7]
    finite = all(map(math.isfinite, (*row[5], row[10], *row[11], row[12], *row[13])))
    unit = abs(x * x + y * y + z * z - 1.0) <= 2e-3
    return 0.0 < row[9] <= largest_n and unit and finite and abs(row[10]) + abs(row[12]) <= 4 * largest_n
