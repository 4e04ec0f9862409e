"""Derivatives against differences of loads over steps in which hardly a point is met or left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model_shapes import FINGER, paper_layout, presses_on

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
    Surface,
    along_surface,
    load_derivatives,
    with_pose,
)

POSE = SensorPose(0.0235, 0.2)
E = 4e8
LAWS = {"linear": None, "stiffening": StressLaw(1.5, 3e-4)}
laws = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
surfaces = pytest.mark.parametrize("surface", [FINGER, Plane()], ids=["cylinder", "plane"])


def _skin(surface: Surface, law: StressLaw | None, pose: SensorPose = POSE, elasticity: float = E) -> Skin:
    patch = Patch.build(surface, paper_layout(), pose, resolution_m=0.25e-3, margin_m=3e-3)
    return Skin(patch, SkinParameters(elasticity, 1.0), law=law)


def _contacts(surface: Surface) -> Contacts:
    rng = np.random.default_rng(0)
    return presses_on(
        surface, rng.uniform(-5e-3, 5e-3, 6), rng.uniform(-5e-3, 5e-3, 6), rng.uniform(0.5, 4.0, 6)
    )


def _close(found: np.ndarray, expected: np.ndarray) -> None:
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


@laws
@surfaces
def test_by_force_and_elasticity(surface: Surface, law: StressLaw | None):
    contacts, ball, h = _contacts(surface), Sphere(0.006), 1e-6
    found = load_derivatives(_skin(surface, law), ball, contacts)
    np.testing.assert_array_equal(found.loads_n, _skin(surface, law).loads(ball, contacts))
    scaled = [replace(contacts, force_n=contacts.force_n * np.exp(s * h)) for s in (-1, 1)]
    low, high = (_skin(surface, law).loads(ball, c) for c in scaled)
    _close(found.by_log_force, (high - low) / (2 * h))
    low, high = (_skin(surface, law, elasticity=E * np.exp(s * h)).loads(ball, contacts) for s in (-1, 1))
    _close(found.by_log_elasticity, (high - low) / (2 * h))


@laws
@surfaces
def test_by_place_of_the_contact(surface: Surface, law: StressLaw | None):
    contacts, ball, h = _contacts(surface), Sphere(0.006), 1e-7
    skin = _skin(surface, law)
    found = load_derivatives(skin, ball, contacts, along_surface(surface, contacts))
    for m in range(2):
        ends = []
        for sign in (-1, 1):
            there = surface.offset(contacts.points_m, sign * h * (m == 0), sign * h * (m == 1))
            ends.append(skin.loads(ball, Contacts(there, surface.normal_at(there), contacts.force_n)))
        _close(found.by_motion[:, m], (ends[1] - ends[0]) / (2 * h))


@surfaces
@pytest.mark.parametrize("name", ["y_m", "alpha_rad", "place"])
def test_by_pose(surface: Surface, name: str):
    if name == "place":
        name = "x_m" if isinstance(surface, Plane) else "beta_rad"
    contacts, ball, h = _contacts(surface), Sphere(0.006), 1e-7 if name.endswith("_m") else 1e-6
    near, far = ([_skin(surface, None, replace(POSE, **{name: getattr(POSE, name) + s * d})) for s in (-1, 1)]
                 for d in (100 * h, h))  # fmt: skip
    skin = _skin(surface, None)
    field = with_pose(skin.patch, near[0].patch, near[1].patch, 200 * h)
    found = load_derivatives(skin, ball, contacts, fields=field[None])
    low, high = (s.loads(ball, contacts) for s in far)
    _close(found.by_field[:, 0], (high - low) / (2 * h))


def test_a_tilted_punch_by_its_tilt():
    contacts = presses_on(Plane(), [0.0, 2e-3], 0.0, [3.0, 2.0])
    skin, punch, h = _skin(Plane(), None), FlatPunch(0.004), 1e-6
    motions = np.tile([0.0, 0.0, 0.0, 0.0, 1.0, 0.0], (2, 1, 1))
    ends = []
    for sign in (-1, 1):
        a = 0.01 + sign * h
        normal = np.tile([np.sin(a), 0.0, np.cos(a)], (2, 1))
        ends.append(skin.loads(punch, Contacts(contacts.points_m, normal, contacts.force_n)))
    tilted = Contacts(contacts.points_m, np.tile([np.sin(0.01), 0.0, np.cos(0.01)], (2, 1)), contacts.force_n)
    found = load_derivatives(skin, punch, tilted, motions)
    expected = (ends[1] - ends[0]) / (2 * h)
    np.testing.assert_allclose(found.by_motion[:, 0], expected, atol=1e-4 * np.abs(expected).max())


def test_derivatives_without_contact_are_zero_or_nan():
    contacts = presses_on(Plane(), [0.0, 0.0, 0.1], 0.0, [np.nan, 0.0, 1.0])
    found = load_derivatives(_skin(Plane(), None), Sphere(0.006), contacts, along_surface(Plane(), contacts))
    assert np.isnan(found.by_log_force[0]).all() and np.isnan(found.by_motion[0]).all()
    assert not found.by_log_force[1:].any() and not found.by_motion[1:].any()
