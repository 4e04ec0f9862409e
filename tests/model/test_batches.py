"""Batches, single presses and presses with many forces: each comes out as it would alone, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from model_shapes import POSE, indenters, presses_on
from published import FINGER, LAYOUT

from skincal.model import Contacts, Patch, Skin, SkinParameters, StressLaw

PATCH = Patch.build(FINGER, LAYOUT, POSE, resolution_m=0.5e-3)
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
