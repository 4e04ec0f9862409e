"""One press: the short way finds what the batch finds."""

from __future__ import annotations

import numpy as np
import pytest
from model_shapes import bolt_mesh, box_mesh
from scipy.spatial.transform import Rotation

from skincal.envs.bodies import Bolt
from skincal.model import (
    Contacts,
    Cylinder,
    FlatPunch,
    Indenter,
    Patch,
    Plane,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    TaxelLayout,
)
from skincal.model.response import loads

LAYOUT = TaxelLayout.grid(4, 4, taxel_size_m=0.0025, pitch_m=0.004)


@pytest.mark.parametrize("surface", [Cylinder(0.0115), Plane()])
def test_it_is_the_batch_of_one_for_all_sizes_forces_and_places(surface: Cylinder | Plane) -> None:
    rng = np.random.default_rng(0)
    patch = Patch.build(
        surface, LAYOUT, SensorPose(0.0235, 0.1, 0.1 if isinstance(surface, Cylinder) else 0.0)
    )
    felt = 0
    for number in range(150):
        beta, y = rng.normal(0, 0.6), rng.normal(0.0235, 0.008)
        out = np.array([np.sin(beta), 0.0, np.cos(beta)])
        point = surface.project((0.0115 * out + [0.0, y, 0.0])[None])
        normal = surface.normal_at(point) + rng.normal(0, 0.15, (1, 3)) * (number % 2)
        turned = number % 3 == 0
        contacts = Contacts(
            point,
            normal / np.linalg.norm(normal),
            10 ** rng.uniform(-3, 2, 1),
            Rotation.random(random_state=number).as_matrix()[None] if turned else None,
            point if turned else None,
        )
        ball, elasticity = Sphere(10 ** rng.uniform(-3, -1.3)), 10 ** rng.uniform(7, 9.5)
        short = Skin(patch, SkinParameters(elasticity, 1.0)).loads(ball, contacts)
        batch = loads(patch, elasticity, ball, contacts)
        assert np.abs(short - batch).max() <= 1e-11 * contacts.force_n[0]
        felt += bool(batch.any())
    assert felt > 50


@pytest.mark.parametrize(
    ("force", "place", "expected"),
    [
        (0.0, 0.0235, 0.0),
        (-1.0, 0.0235, 0.0),
        (np.nan, 0.0235, np.nan),
        (1.0, np.nan, np.nan),
        (1.0, 0.3, 0.0),
    ],
)
def test_odd_presses_are_those_of_the_batch(force: float, place: float, expected: float) -> None:
    skin = Skin(Patch.build(Plane(), LAYOUT, SensorPose(0.0235, 0.0)), SkinParameters(5e8, 1.0))
    contacts = Contacts(np.array([[0.0, place, 0.0]]), np.array([[0.0, 0.0, 1.0]]), np.array([force]))
    assert np.array_equal(skin.loads(Sphere(0.006), contacts), np.full((1, 16), expected), equal_nan=True)


INDENTERS = {
    "a bolt with a bound of its own": Bolt(0.006, 0.006).indenter,
    "a mesh that is not convex": bolt_mesh(),
    "a box": box_mesh(),
    "a punch": FlatPunch(0.004),
}


@pytest.mark.parametrize("cell_m", [0.5e-3, 4e-3])
@pytest.mark.parametrize("indenter", INDENTERS.values(), ids=INDENTERS)
@pytest.mark.parametrize("free", [False, True])
def test_other_indenters_are_the_batch_of_one_too(indenter: Indenter, free: bool, cell_m: float) -> None:
    rng = np.random.default_rng(1)
    patch = Patch.build(Cylinder(0.0115), LAYOUT, SensorPose(0.0235, 0.1, 0.1), cell_m)
    felt = 0
    for number in range(80):
        beta, y = rng.normal(0, 0.6), rng.normal(0.0235, 0.008)
        out = np.array([np.sin(beta), 0.0, np.cos(beta)])
        point = 0.0115 * out + [0.0, y, 0.0]
        normal = out + rng.normal(0, 0.1, 3) * (number % 2)
        normal /= np.linalg.norm(normal)
        rotation = Rotation.random(random_state=number).as_matrix() if free else None
        origin = point + rng.uniform(0.0, 0.008) * normal if free else None
        force, elasticity = 10 ** rng.uniform(-3, 1.5), 10 ** rng.uniform(7, 9.5)
        contacts = Contacts.one(point, normal, force, rotation, origin)
        assert contacts.known.all()
        short = Skin(patch, SkinParameters(elasticity, 1.0)).loads(indenter, contacts)
        batch = loads(patch, elasticity, indenter, contacts)
        assert np.abs(short - batch).max() <= 1e-9 * force
        felt += bool(batch.any())
    assert felt > 12


def test_an_unchecked_contact_is_the_checked_one() -> None:
    point, normal, rotation = np.array([0.001, 0.02, 0.01]), np.array([0.0, 0.6, 0.8]), np.eye(3)[[1, 2, 0]]
    one = Contacts.one(point, normal, 2.0, rotation, 2 * point)
    checked = Contacts(point[None], normal[None], np.array([2.0]), rotation[None], 2 * point[None])
    for name in ("points_m", "normals", "force_n", "rotations", "origins_m", "local_directions", "known"):
        assert np.array_equal(getattr(one, name), getattr(checked, name)), name
    assert not Contacts.one(point, normal, np.nan).known[0]
    assert not Contacts.one(point, normal, 1.0, rotation * np.nan, point).known[0]
