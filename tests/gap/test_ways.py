"""Contacts that move within a press: the way is known no better than the place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.made_sessions import OPTIONS, Made, based, made, pressed, scene_of

from skincal.effects.samples import HOLD
from skincal.gap.models import excess_of
from skincal.gap.session import GapSession


def wandering(session: GapSession, along_m: float) -> GapSession:
    """The session with contacts that come from along the finger as the force rises, and go back."""
    samples = session.samples
    force = np.where(samples.touching, samples.contacts.force_n, 0.0)
    most = np.array([force[samples.press == p].max(initial=1e-9) for p in samples.press])
    points = samples.contacts.points_m.copy()
    points[:, 1] += along_m * (1 - force / most) * samples.touching
    return replace(session, samples=replace(samples, contacts=replace(samples.contacts, points_m=points)))


def recorded(measured_m: float, true_m: float) -> Made:
    """A session whose contacts move by one way and are said to move by another."""
    one = made({}, wandering(pressed(), true_m))
    measured = wandering(pressed(), measured_m)
    return replace(one, session=replace(measured, counts=one.session.counts))


def test_a_way_is_measured_from_the_hold():
    session = wandering(pressed(), 3e-4)
    ways = session.paths_m
    assert pressed().paths_m.max() < 1e-12
    assert ways[session.phase == HOLD].max() < 1e-6
    assert (ways[session.press < 0] == 0).all()
    assert 1e-4 < ways.max() < 3e-4


def test_presses_that_stay_have_no_way():
    one = made()
    assert scene_of(one, based(one)).nuisance.shape[-1] == 3


def test_a_way_is_off_by_half_of_it_or_by_as_much_as_a_place():
    one = recorded(3e-4, 3e-4)
    scene = scene_of(one, based(one))
    assert scene.nuisance.shape[-1] == 5
    place, way = scene.slopes.place[..., 1], scene.nuisance[..., 4]
    some = np.abs(place) > 1
    ratio = way[some] / place[some]
    expected = np.minimum(0.5 * one.session.paths_m, OPTIONS.position_sigma_m)
    assert ratio == pytest.approx(np.broadcast_to(expected[:, None], some.shape)[some])


def test_what_an_error_of_the_way_leaves_is_no_gap():
    right, wrong = recorded(2e-4, 2e-4), recorded(2e-4, 4e-4)
    found: list[float] = []
    for one in (right, wrong):
        model = based(one)
        found.append(excess_of(model, one.material, 1.0))
    # The same error where contacts are said to stay is one.
    still = recorded(0.0, 2e-4)
    bare = excess_of(based(still), still.material, 1.0)
    assert bare > 300
    assert found[1] - found[0] < 0.4 * bare
