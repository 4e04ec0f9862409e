"""Presses that the model cannot answer say so: never a silent zero."""

from __future__ import annotations

import numpy as np
import pytest
from model_shapes import sphere_mesh
from published import FINGER, LAYOUT, RADIUS_M

from skincal.model import (
    Contacts,
    FlatPunch,
    Indenter,
    Patch,
    Plane,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    Status,
    Surface,
    TaxelLayout,
)

FINE = TaxelLayout.grid(8, 8, taxel_size_m=1e-3, pitch_m=1e-3)


def _skin(surface: Surface) -> Skin:
    return Skin(Patch.build(surface, FINE, SensorPose(0.0, 0.0), margin_m=2e-3), SkinParameters(5e8, 1.0))


def _on(surface: Surface, force_n: float, u: float = 0.0, v: float = 0.0) -> Contacts:
    points, normals = surface.wrap(SensorPose(0.0, 0.0), [[u, v]])
    return Contacts(points, normals, [force_n])


@pytest.mark.parametrize("surface", [FINGER, Plane()])
@pytest.mark.parametrize(
    "indenter", [Sphere(1e-6), Sphere(1e-4), FlatPunch(1e-6), FlatPunch(1e-4), sphere_mesh(2, 1e-4)]
)
def test_an_indenter_between_the_points_is_refused(surface: Surface, indenter: Indenter):
    skin = _skin(surface)
    statuses = set()
    for u, v in np.random.default_rng(0).uniform(-3e-3, 3e-3, (40, 2)):
        contacts = _on(surface, 1.0, u, v)
        status = Status(skin.respond(indenter, contacts).status[0])
        statuses.add(status)
        # A point may happen to lie below it: then the press goes through.
        assert status in (Status.FINER_THAN_POINTS, Status.THROUGH_FINGER) or isinstance(indenter, FlatPunch)
        if status == Status.FINER_THAN_POINTS:
            for ask in (skin.image, skin.values, skin.loads):
                with pytest.raises(ValueError, match="not finer than the tactile points"):
                    ask(indenter, contacts)
    assert Status.FINER_THAN_POINTS in statuses
    assert Status.OK not in statuses or isinstance(indenter, FlatPunch)


def test_a_press_off_the_patch_is_not_finer_than_the_points():
    assert _skin(Plane()).respond(Sphere(1e-4), _on(Plane(), 1.0, 0.1)).status[0] == Status.NOT_TOUCHED


@pytest.mark.parametrize(
    ("surface", "indenter", "force"),
    [
        (Plane(), Sphere(0.006), 1e3),
        (FINGER, Sphere(0.006), 1e6),
        (FINGER, Sphere(0.05), 1e4),
        (FINGER, FlatPunch(0.003), 1e5),
        (Plane(), sphere_mesh(3), 1e3),
    ],
)
def test_a_press_through_the_finger_is_refused(surface: Surface, indenter: Indenter, force: float):
    skin, contacts = _skin(surface), _on(surface, force)
    response = skin.respond(indenter, contacts)
    assert response.status[0] == Status.THROUGH_FINGER
    assert response.penetration_m[0] > 0.006
    assert response.force_n[0] == pytest.approx(force)
    with pytest.raises(ValueError, match="m deep"):
        skin.image(indenter, contacts)
    assert skin.respond(indenter, _on(surface, 1.0)).status[0] == Status.OK


@pytest.mark.parametrize("indenter", [Sphere(0.006), FlatPunch(0.002), sphere_mesh(2)])
@pytest.mark.parametrize("force", [5e-324, 1e-300, 1e-12, 1e12, 1e300])
@pytest.mark.parametrize("elasticity", [1e-300, 1.0, 1e15, 1e300])
def test_extreme_numbers_end(indenter: Indenter, force: float, elasticity: float):
    patch = Patch.build(FINGER, LAYOUT, SensorPose(0.0, 0.0), resolution_m=1e-3)
    contacts = Contacts([[0.0, 0.0, RADIUS_M]], [[0.0, 0.0, 1.0]], [force])
    response = Skin(patch, SkinParameters(elasticity, 1.0)).respond(indenter, contacts)
    assert response.status[0] in (Status.OK, Status.AT_BORDER, Status.THROUGH_FINGER, Status.UNKNOWN)
