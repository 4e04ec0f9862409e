"""Single presses of all sizes, forces and attitudes against the paper's equations written out."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from model_shapes import bolt_mesh, box_mesh, cylinder_mesh, plain_loads, sphere_mesh, surface_of
from published import LAYOUT
from scipy.spatial.transform import Rotation

from skincal.envs.bodies import Bolt
from skincal.model import (
    Contacts,
    Cylinder,
    FlatPunch,
    Patch,
    Plane,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    TaxelLayout,
)

FREE = TaxelLayout(
    1, 3, [[-3e-3, 0.0], [0.0, 1e-3], [4e-3, -2e-3]], [[2e-3, 4e-3], [3e-3, 3e-3], [2e-3, 1e-3]]
)
SURFACES = {"cylinder": Cylinder(0.0115), "plane": Plane(), "mesh": surface_of(cylinder_mesh(48))}
INDENTERS = {
    "a ball": Sphere(0.006),
    "a small ball": Sphere(0.001),
    "a punch": FlatPunch(0.004),
    "a ball of triangles": sphere_mesh(3),
    "a bolt": Bolt(0.006, 0.006).indenter,
    "a mesh that is not convex": bolt_mesh(),
    "a box": box_mesh(),
}


CASES = [
    pytest.param(
        *(surface, indenter, free),
        id=f"{surface}-{indenter}-{'free' if free else 'upright'}",
        marks=[] if surface == "cylinder" or (free and indenter in ("a ball", "a box")) else pytest.mark.slow,
    )
    for surface, indenter, free in product(SURFACES, INDENTERS, (False, True))
]
"""All indenters on the cylinder; of the other surfaces two, and the rest are slow."""


@pytest.mark.parametrize(("on", "by", "free"), CASES)
def test_any_press_follows_the_equations(on: str, by: str, free: bool) -> None:
    surface, indenter = SURFACES[on], INDENTERS[by]
    rng = np.random.default_rng(1)
    turn = 0.0 if isinstance(surface, Plane) else 0.1
    felt = 0
    patches = [
        Patch.build(surface, layout, SensorPose(0.0235, 0.1, turn), cell)
        for layout, cell in ((LAYOUT, 0.5e-3), (FREE, 1.5e-3))
    ]
    for number in range(30):
        beta, y = rng.normal(0, 0.3), rng.normal(0.0235, 0.004)
        point = surface.project(np.array([[0.0115 * np.sin(beta), y, 0.0115 * np.cos(beta)]]))
        normal = surface.normal_at(point) + rng.normal(0, 0.1, (1, 3)) * (number % 2)
        normal /= np.linalg.norm(normal)
        rotation = Rotation.random(random_state=number).as_matrix()[None] if free else None
        origin = point + rng.uniform(0.0, 0.008) * normal if free else None
        force, elasticity = 10 ** rng.uniform(-3, 1.5, 1), 10 ** rng.uniform(6, 10)
        contacts = Contacts(point, normal, force, rotation, origin)
        patch = patches[number % 2]
        expected = plain_loads(patch, indenter, contacts, elasticity)
        found = Skin(patch, SkinParameters(elasticity, 1.0)).respond(indenter, contacts).loads_n
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * force[0])
        felt += bool(expected.any())
    assert felt > 2


def test_an_unchecked_contact_is_the_checked_one() -> None:
    point, normal, rotation = np.array([0.001, 0.02, 0.01]), np.array([0.0, 0.6, 0.8]), np.eye(3)[[1, 2, 0]]
    one = Contacts.one(point, normal, 2.0, rotation, 2 * point)
    checked = Contacts(point[None], normal[None], np.array([2.0]), rotation[None], 2 * point[None])
    for name in ("points_m", "normals", "force_n", "rotations", "origins_m", "known"):
        assert np.array_equal(getattr(one, name), getattr(checked, name)), name
    assert not Contacts.one(point, normal, np.nan).known[0]
    assert not Contacts.one(point, normal, 1.0, rotation * np.nan, point).known[0]
