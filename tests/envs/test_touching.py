"""Contact points made one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skincal.envs.scene_state import Point, merged


def row(
    force: float,
    place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0),
    friction: float = 0.0,
) -> Point:
    return Point(place, normal, force, (friction, 0.0, 0.0))


def test_it_does_not_matter_how_many_points_carry_a_force() -> None:
    one = merged([row(2.0, (0.0, 0.01, 0.0), friction=0.4)], 100.0)
    many = merged([row(0.5, (0.0, 0.01, 0.0), friction=0.1) for _ in range(4)], 100.0)
    assert one is not None and many is not None
    assert many.force_n == pytest.approx(one.force_n)
    assert many.point_m == pytest.approx(one.point_m)
    assert many.normal == pytest.approx(one.normal) and one.normal == (0.0, 0.0, 1.0)
    assert many.friction_n == pytest.approx(one.friction_n)
    assert (one.points, many.points) == (1, 4)


def test_points_count_by_their_force() -> None:
    tilted = (math.sin(0.4), 0.0, math.cos(0.4))
    found = merged([row(3.0, (0.0, 0.0, 0.0)), row(1.0, (0.0, 0.008, 0.0), tilted)], 100.0)
    assert found is not None
    assert found.force_n == pytest.approx(4.0)
    assert found.point_m == pytest.approx((0.0, 0.002, 0.0))
    mean = 3.0 * np.array([0.0, 0.0, 1.0]) + 1.0 * np.array(tilted)
    assert found.normal == pytest.approx(tuple(mean / np.linalg.norm(mean)))


@pytest.mark.parametrize(
    "bad",
    [
        row(math.nan),
        row(math.inf),
        row(1e6),
        row(-1.0),
        row(0.0),
        row(1.0, (math.nan, 0.0, 0.0)),
        row(1.0, normal=(math.nan, 0.0, 1.0)),
        row(1.0, normal=(0.0, 0.0, 2.0)),
        row(1.0, friction=math.nan),
    ],
)
def test_implausible_contacts_are_left_out(bad: Point) -> None:
    assert merged([bad], 100.0) is None
    found = merged([bad, row(1.5, (0.0, 0.01, 0.0))], 100.0)
    assert found is not None and found.force_n == 1.5 and found.points == 1


def test_no_points_are_no_contact() -> None:
    assert merged([], 100.0) is None
