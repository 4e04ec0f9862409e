"""One press of a ball: the short way finds what the batch finds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.model import (
    Contacts,
    Cylinder,
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
