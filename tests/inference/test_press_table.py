"""Tables of loads against the model itself."""

from __future__ import annotations

import numpy as np
import pytest
from effects.effect_sessions import FINGER, LAYOUT
from inference.made import bare_loads
from killing import forked

from skincal.inference.press_table import Presses, press_table
from skincal.model import (
    Contacts,
    FlatPunch,
    Patch,
    Plane,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    StressLaw,
)

PATCH = Patch.build(
    FINGER, LAYOUT, SensorPose(y_m=0.0235, alpha_rad=0.05, beta_rad=0.02), 3.5e-4, 6e-3, "gauss"
)
E = 4e8


def presses() -> Presses:
    rng = np.random.default_rng(0)
    points = FINGER.offset(
        np.tile(FINGER.wrap(SensorPose(y_m=0.0235, alpha_rad=0.0), np.zeros((1, 2)))[0], (12, 1)),
        *rng.uniform(-5e-3, 5e-3, (2, 12)),
    )
    return Presses(points, FINGER.normal_at(points), np.zeros(12, dtype=np.int64), np.full(12, 5.0))


@pytest.mark.parametrize("law", [None, StressLaw(1.2, 5e-4)])
@pytest.mark.parametrize("thing", [Sphere(0.006), FlatPunch(0.004)])
def test_a_table_is_the_model(law: StressLaw | None, thing: object):
    given, rng = presses(), np.random.default_rng(1)
    table = press_table(PATCH, FINGER, (thing,), given, E, law)  # type: ignore[arg-type]
    force = rng.uniform(0.05, 4.5, 12)
    skin = Skin(PATCH, SkinParameters(E, 1.0), law=law)
    want = skin.loads(thing, Contacts(given.points_m, given.normals, force))  # type: ignore[arg-type]
    got = E * table.at(np.arange(12), force / E)
    assert np.abs(got - want).max() < 0.01 * want.max()


def test_a_point_at_the_equator_of_the_ball_takes_no_load():
    flat = Patch.build(Plane(), LAYOUT, SensorPose(0.0, 0.0), 3.5e-4, 6e-3, "gauss")
    up, law = np.array([[0.0, 0.0, 1.0]]), StressLaw(0.9, 5e-4)
    at = Presses(np.zeros((1, 3)), up, np.zeros(1, dtype=np.int64), np.full(1, 10.0))
    aside = np.linalg.norm(flat.points_m[:, :2], axis=1)
    radius = np.sort(aside)[np.searchsorted(np.sort(aside), 4e-3)]
    # A hair more than the distance of a point, and so much more that it is no special one.
    near, far = (
        press_table(flat, Plane(), (Sphere(radius * more),), at, E, law).terms[0, 0]
        for more in (1 + 1e-12, 1 + 1e-3)
    )
    assert np.abs(near - far).max() < 0.005 * far.max()


def test_a_table_has_the_pressure_itself():
    given, force = presses(), np.random.default_rng(1).uniform(0.5, 4.5, 12)
    own, bare = (press_table(PATCH, FINGER, (Sphere(0.006),), given, E, bare=part) for part in (0.0, 1.0))
    skin, at = Skin(PATCH, SkinParameters(E, 1.0)), Contacts(given.points_m, given.normals, force)
    want = bare_loads(skin, Sphere(0.006), at)
    got, less = (E * table.at(np.arange(12), force / E) for table in (bare, own))
    assert np.abs(got - want).max() < 0.01 * want.max() < 0.5 * np.abs(less - want).max()
    half = press_table(PATCH, FINGER, (Sphere(0.006),), given, E, bare=0.5)
    assert half.terms[0] == pytest.approx((own.terms[0] + bare.terms[0]) / 2)


def test_a_small_move_is_in_the_table():
    given = presses()
    table = press_table(PATCH, FINGER, (Sphere(0.006),), given, E)
    move = np.random.default_rng(2).uniform(-1.2e-4, 1.2e-4, (12, 2))
    there = given.moved(FINGER, move)
    force = np.full(12, 2.0)
    want = Skin(PATCH, SkinParameters(E, 1.0)).loads(
        Sphere(0.006), Contacts(there.points_m, there.normals, force)
    )
    assert np.abs(E * table.at(np.arange(12), force / E, move) - want).max() < 0.005 * want.max()
    none = E * table.at(np.arange(12), force / E)
    assert np.abs(none - want).max() > 0.02 * want.max()


def test_slopes_of_a_table_are_what_differences_say():
    given, row = presses(), np.arange(12)
    table, rng = press_table(PATCH, FINGER, (Sphere(0.006),), given, E), np.random.default_rng(2)
    # Within the table, and beyond its largest force.
    load, move = rng.uniform(0.5, 6.0, 12) / E, rng.uniform(-1e-4, 1e-4, (12, 2))
    value, *slopes = table.with_slopes(row, load, move)
    assert np.array_equal(value, table.at(row, load, move))
    h = 1e-6
    for k, axis in enumerate(np.eye(2)):
        apart = table.at(row, load, move + h * axis) - table.at(row, load, move - h * axis)
        assert slopes[k] == pytest.approx(apart / (2 * h), abs=1e-6 * np.abs(slopes[k]).max())
    apart = table.at(row, load * (1 + h), move) - table.at(row, load * (1 - h), move)
    assert slopes[2] == pytest.approx(apart / (2 * h), abs=1e-6 * np.abs(slopes[2]).max())


@pytest.mark.parametrize("law", [None, StressLaw(1.2, 5e-4)])
def test_even_pressure_needs_no_casting(law: StressLaw | None):
    patch = Patch.build(Plane(), LAYOUT, SensorPose(y_m=0.0, alpha_rad=0.1), 3.5e-4, 6e-3, "gauss")
    force, up = np.linspace(0.5, 4.0, 5), np.tile([0.0, 0.0, 1.0], (5, 1))
    given = Presses(np.zeros((5, 3)), up, np.zeros(5, dtype=np.int64), np.full(5, 5.0))
    table = press_table(patch, Plane(), (FlatPunch(0.05),), given, E, law)
    want = Skin(patch, SkinParameters(E, 1.0), law=law).loads(
        FlatPunch(0.05), Contacts(given.points_m, up, force)
    )
    got = E * table.at(np.arange(5), force / E, np.full((5, 2), 2e-4))
    assert np.abs(got - want).max() < 1e-9 * want.max()
    assert not np.any(table.terms[1:])


def test_a_fork_makes_tables():
    """It has none of the threads of the process that it came from."""

    def made() -> None:
        press_table(PATCH, FINGER, (Sphere(0.006),), presses(), E)

    made()
    assert forked(made)[0] == 0
