"""Presses with many forces: settled together, they come out as each would alone."""

from __future__ import annotations

import numpy as np
import pytest
from model_shapes import FINGER, POSE, indenters, paper_layout, presses_on

from skincal.model import Contacts, Patch, Skin, SkinParameters, StressLaw
from skincal.model.arrays import FloatArray, IntArray
from skincal.model.strokes import Reached, strokes

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
    groups = strokes(contacts, pressed(contacts))
    assert groups is not None
    assert len(groups) == PRESSES
    alone = SKIN.respond(indenter, contacts).loads_n
    assert alone.max() > 0.3
    np.testing.assert_allclose(SKIN.loads(indenter, contacts), alone, rtol=1e-9, atol=1e-12)


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


def test_a_load_does_not_depend_on_the_other_samples_of_its_press():
    contacts = up_and_down(3)
    some = np.arange(len(contacts)) % 3 > 0
    indenter = indenters()["sphere"]
    few, all_of_them = SKIN.loads(indenter, contacts[some]), SKIN.loads(indenter, contacts)[some]
    np.testing.assert_allclose(few, all_of_them, rtol=1e-12, atol=1e-15)


def test_a_press_beside_the_patch_has_no_load():
    far = presses_on(FINGER, np.full(8, 15e-3), np.full(8, 20e-3), np.linspace(0.5, 4.0, 8))
    assert strokes(far, np.arange(8)) is not None
    assert not SKIN.loads(indenters()["flat"], far).any()


def test_presses_of_one_sample_are_left_alone():
    contacts = up_and_down()[np.arange(0, PRESSES * FORCES, FORCES) + 5]
    assert strokes(contacts, np.arange(len(contacts))) is None
    assert strokes(contacts, np.array([0])) is None


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


def test_presses_worked_out_in_small_batches_come_out_the_same(monkeypatch: pytest.MonkeyPatch):
    indenter, contacts = indenters()["sphere mesh"], up_and_down(4)
    whole = SKIN.loads(indenter, contacts)
    batches: list[int] = []
    made = Reached.depths

    def counted(self: Reached, press: IntArray, load_m3: FloatArray, law: StressLaw | None) -> FloatArray:
        batches.append(len(self.gap_m))
        return made(self, press, load_m3, law)

    monkeypatch.setattr(Reached, "depths", counted)
    monkeypatch.setattr("skincal.model.strokes._AT_ONCE", 4000)
    assert np.array_equal(SKIN.loads(indenter, contacts), whole)
    assert len(batches) > 2
    assert sum(batches) == PRESSES
