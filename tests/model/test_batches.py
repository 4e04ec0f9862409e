"""Batches, single presses and presses with many forces: each comes out as it would alone, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from model_shapes import FINGER, POSE, indenters, paper_layout, plain_loads, presses_on

from skincal.model import Contacts, Patch, Skin, SkinParameters, StressLaw
from skincal.model.press.call import count_places

PATCH = Patch.build(FINGER, paper_layout(), POSE, resolution_m=0.5e-3)
SKIN = Skin(PATCH, SkinParameters(4e8, 70.0))
MEMBERSHIP = (PATCH.taxel[:, None] == np.arange(16)).astype(float)
PRESSES, FORCES = 9, 25


def up_and_down(seed: int = 0) -> Contacts:
    """Presses one after the other, each with forces that rise and fall, some of them zero."""
    rng = np.random.default_rng(seed)
    place = np.repeat(rng.uniform(-8e-3, 8e-3, (PRESSES, 2)), FORCES, axis=0)
    force = np.concatenate(
        [most * np.sin(np.linspace(0, np.pi, FORCES)) for most in rng.uniform(0.2, 5.0, PRESSES)]
    )
    return presses_on(FINGER, place[:, 0], place[:, 1], np.maximum(force, 0.0))


def pressed(contacts: Contacts) -> np.ndarray:
    return np.flatnonzero(contacts.known & (contacts.force_n > 0))


@pytest.mark.parametrize("kind", indenters())
def test_loads_are_those_of_single_contacts(kind: str):
    indenter, contacts = indenters()[kind], up_and_down()
    assert count_places(contacts) == PRESSES
    loads = SKIN.loads(indenter, contacts)
    assert loads.max() > 0.3
    some = np.arange(0, len(contacts), 7)  # of every press, at forces that rise and fall
    expected = plain_loads(PATCH, indenter, contacts[some], 4e8)
    np.testing.assert_allclose(loads[some], expected, rtol=1e-9, atol=1e-12)


def test_loads_of_points_are_those_of_single_contacts():
    indenter, contacts = indenters()["bolt mesh"], up_and_down(1)
    alone = SKIN.respond(indenter, contacts).loads_n
    loads = SKIN.pressures(indenter, contacts).loads(MEMBERSHIP)
    np.testing.assert_allclose(loads, alone, rtol=1e-9, atol=1e-12)


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


def test_a_load_is_independent_of_other_samples():
    contacts = up_and_down(3)
    some = np.arange(len(contacts)) % 3 > 0
    indenter = indenters()["sphere"]
    few, all_of_them = SKIN.loads(indenter, contacts[some]), SKIN.loads(indenter, contacts)[some]
    assert np.array_equal(few, all_of_them)


def test_a_press_beside_the_patch_has_no_load():
    far = presses_on(FINGER, np.full(8, 15e-3), np.full(8, 20e-3), np.linspace(0.5, 4.0, 8))
    assert count_places(far) == 1
    assert not SKIN.loads(indenters()["flat"], far).any()


@pytest.mark.parametrize("exponent", [0.6, 1.7])
@pytest.mark.parametrize("kind", ["sphere", "bolt mesh"])
def test_another_law_gives_what_single_contacts_do(exponent: float, kind: str):
    contacts, law = up_and_down(), StressLaw(exponent, 5e-4)
    skin, indenter = Skin(PATCH, SKIN.parameters, law=law), indenters()[kind]
    alone = skin.respond(indenter, contacts).loads_n
    assert np.abs(alone - SKIN.loads(indenter, contacts)).max() > 0.01
    np.testing.assert_allclose(skin.loads(indenter, contacts), alone, rtol=1e-9, atol=1e-12)
    loads = skin.pressures(indenter, contacts).loads(MEMBERSHIP)
    np.testing.assert_allclose(loads, alone, rtol=1e-9, atol=1e-12)


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
