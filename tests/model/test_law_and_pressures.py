"""Stress that is no line in the penetration, loads point by point, and batches that give what each press gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model_shapes import POSE, indenters
from published import FINGER, LAYOUT, presses_on

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
    TaxelLayout,
)

PATCH = Patch.build(FINGER, LAYOUT, POSE, resolution_m=0.5e-3)
SKIN = Skin(PATCH, SkinParameters(4e8, 70.0))
MEMBERSHIP = (PATCH.taxel[:, None] == np.arange(16)).astype(float)
PRESSES, FORCES = 9, 25


def some_contacts(count: int = 40) -> Contacts:
    rng = np.random.default_rng(1)
    return presses_on(
        FINGER, rng.uniform(-9e-3, 9e-3, count), rng.uniform(-9e-3, 9e-3, count), rng.uniform(0.0, 4.0, count)
    )


@pytest.mark.parametrize("kind", indenters())
def test_loads_of_points_add_up_to_those_of_taxels(kind: str):
    indenter, contacts = indenters()[kind], some_contacts(12)
    loads = SKIN.pressures(indenter, contacts).loads(MEMBERSHIP)
    np.testing.assert_allclose(loads, SKIN.loads(indenter, contacts), rtol=1e-12, atol=1e-14)


def test_unknown_contacts_have_no_loads():
    contacts = presses_on(FINGER, [0.0, 0.0, 0.0], 0.0, [np.nan, 2.0, 0.0])
    loads = SKIN.pressures(Sphere(0.006), contacts).loads(MEMBERSHIP)
    assert np.isnan(loads[0]).all()
    np.testing.assert_allclose(loads[1:], SKIN.loads(Sphere(0.006), contacts)[1:], atol=1e-14)
    nothing = presses_on(FINGER, 0.0, 0.0, [0.0])
    assert not SKIN.pressures(Sphere(0.006), nothing).loads(MEMBERSHIP).any()


def test_exponent_one_is_the_linear_law():
    linear = SKIN.respond(Sphere(0.006), some_contacts())
    power = replace(SKIN, law=StressLaw(1.0, 5e-4)).respond(Sphere(0.006), some_contacts())
    np.testing.assert_allclose(power.loads_n, linear.loads_n, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(power.penetration_m, linear.penetration_m, rtol=1e-12)


@pytest.mark.parametrize("reference_m", [3e-5, 3e-4, 5e-3])
@pytest.mark.parametrize("exponent", [0.3, 0.4, 0.7, 1.3, 2.0, 3.5])
@pytest.mark.parametrize("kind", ["sphere", "flat", "bolt mesh"])
def test_every_law_carries_the_force(kind: str, exponent: float, reference_m: float):
    contacts = some_contacts(200)
    response = replace(SKIN, law=StressLaw(exponent, reference_m)).respond(indenters()[kind], contacts)
    touched = response.points > 0
    assert touched.sum() > 10
    # The steeper a stress begins, the less exactly a depth that is rounded gives the force.
    exact = 1e-11 if exponent >= 0.4 else 1e-6
    np.testing.assert_allclose(response.force_n[touched], contacts.force_n[touched], rtol=exact)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_a_flat_punch_on_a_plane_goes_in_as_the_power_law_says(exponent: float):
    layout = TaxelLayout.grid(1, 1, taxel_size_m=4e-3, pitch_m=4e-3)
    patch = Patch.build(Plane(), layout, SensorPose(0.0, 0.0), resolution_m=0.5e-3, margin_m=0.0)
    skin = Skin(patch, SkinParameters(2e8, 1.0), law=StressLaw(exponent, 2e-4))
    contact = Contacts(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([0.7]))
    # F = E eps_0 (eps / eps_0)^n A, with A = 16 mm².
    expected = 2e-4 * (0.7 / (2e8 * 2e-4 * 16e-6)) ** (1 / exponent)
    response = skin.respond(FlatPunch(0.01), contact)
    assert response.penetration_m[0] == pytest.approx(expected, rel=1e-12)
    assert response.loads_n[0, 0] == pytest.approx(0.7, rel=1e-12)


@pytest.mark.parametrize(("exponent", "reference"), [(0.0, 1e-3), (-1.0, 1e-3), (1.0, 0.0), (np.nan, 1e-3)])
def test_laws_that_make_no_sense_are_refused(exponent: float, reference: float):
    with pytest.raises(ValueError, match="law"):
        StressLaw(exponent, reference)


def test_patch_knows_where_its_points_lie_on_it():
    points, _ = FINGER.wrap(POSE, PATCH.uv_m)
    np.testing.assert_array_equal(points, PATCH.points_m)
    with pytest.raises(ValueError, match="uv_m"):
        replace(PATCH, uv_m=np.zeros((3, 2)))


def up_and_down(seed: int = 0) -> Contacts:
    """Presses one after the other, each with forces that rise and fall, some of them zero."""
    rng = np.random.default_rng(seed)
    place = np.repeat(rng.uniform(-8e-3, 8e-3, (PRESSES, 2)), FORCES, axis=0)
    force = np.concatenate(
        [most * np.sin(np.linspace(0, np.pi, FORCES)) for most in rng.uniform(0.2, 5.0, PRESSES)]
    )
    return presses_on(FINGER, place[:, 0], place[:, 1], np.maximum(force, 0.0))


def test_samples_that_are_not_known_split_nothing_else():
    contacts = up_and_down(2)
    force = contacts.force_n.copy()
    force[[3, 4, 60]] = np.nan
    holes = Contacts(contacts.points_m, contacts.normals, force)
    indenter = indenters()["sphere"]
    found, whole = SKIN.loads(indenter, holes), SKIN.loads(indenter, contacts)
    assert np.isnan(found[[3, 4, 60]]).all()
    sound = np.isfinite(force)
    assert np.array_equal(found[sound], whole[sound])


@pytest.mark.parametrize("law", [None, StressLaw(1.4, 5e-4)], ids=["linear", "power"])
@pytest.mark.parametrize("kind", indenters())
def test_any_split_of_a_batch_gives_the_same_bytes(kind: str, law: StressLaw | None):
    skin, indenter, contacts = Skin(PATCH, SKIN.parameters, law=law), indenters()[kind], up_and_down(4)
    whole = skin.loads(indenter, contacts)
    assert whole.any()
    for size in (1, 7, 60):
        parts = [
            skin.loads(indenter, contacts[k : k + size])
            for k in range(0, len(contacts) if size > 1 else 60, size)
        ]
        assert np.concatenate(parts).tobytes() == whole[: sum(map(len, parts))].tobytes(), size
    order = np.random.default_rng(0).permutation(len(contacts))
    assert skin.loads(indenter, contacts[order]).tobytes() == whole[order].tobytes()
