"""Contacts that move within a press: nodes along their paths, twins that follow them, and what images show of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from inference.test_joint_fit import seen

from skincal.inference.fit import Fitter
from skincal.inference.forward import LAW, Forward, State
from skincal.inference.paths import Paths
from skincal.inference.session import GapSession
from skincal.inference.start import session_as_shown
from skincal.inference.twins import twin_values
from skincal.model import Contacts


def model(session: GapSession) -> Forward:
    """The model of a session of the same sensor."""
    own = seen("nothing").fitter.forward
    return Forward(session, own.surface, own.layout, own.noise, clipped=own.rests_clipped)


@cache
def moving(far_m: float) -> Forward:
    """The model of a session whose contacts move by so much as the force grows."""
    own = seen("nothing").fitter.forward
    samples = own.session.samples
    force = np.where(samples.touching, np.nan_to_num(samples.contacts.force_n), 0.0)
    far = far_m * force / force.max()
    points, normals = samples.contacts.points_m.copy(), samples.contacts.normals.copy()
    on = samples.touching & np.isfinite(points).all(axis=1)
    points[on] = own.surface.offset(own.surface.project(points[on]), far[on], -far[on])
    normals[on] = own.surface.normal_at(points[on])
    contacts = replace(samples.contacts, points_m=points, normals=normals)
    return model(replace(own.session, samples=replace(samples, contacts=contacts)))


def start() -> State:
    """The foundation, without spreading, and taxels that feel what is projected twice."""
    return replace(seen("nothing").fitter.priors.start, law=np.zeros(len(LAW)))


def test_nodes_are_laid_where_a_press_moves():
    along = np.array([0.0, 0.2, 1.1, -0.7, 0.1, 0.0, 0.0]) * 1e-3
    off, row = np.stack([along, along], axis=1) / np.sqrt(2), np.array([0, 0, 0, 0, 1, 1, -1])
    paths = Paths.of(off, row, 2, 5e-4)
    # Its place, two behind and three ahead; the other press moves too little.
    assert paths.press.tolist() == [0] * 6 + [1]
    assert paths.before.tolist()[-3:] == [6, 6, -1] and paths.after.tolist()[-3:] == [6, 6, -1]
    first, second = (paths.offset_m[nodes[:4]] for nodes in (paths.before, paths.after))
    np.testing.assert_allclose(first + paths.part[:4, None] * (second - first), off[:4], atol=1e-12)
    nearest = paths.offset_m[paths.nearest[:4]]
    assert np.linalg.norm(nearest - off[:4], axis=1).max() <= 2.5e-4


def test_loads_of_contacts_that_move_are_those_of_the_model():
    forward, state = moving(1.2e-3), start()
    felt = forward.predict(state)
    on = np.flatnonzero(forward.row >= 0)[::5]
    points = forward.samples.contacts.points_m[on]
    force = forward.force_n(felt.felt, state)[on]
    skin = forward.skin(state).skin
    want = skin.loads(
        forward.samples.indenters[0], Contacts(points, forward.surface.normal_at(points), force)
    )
    assert np.abs(felt.loads[on] - want).max() < 0.01 * want.max()


def test_a_twin_under_the_models_own_law_is_the_model():
    forward, state = moving(1.2e-3), start()
    want = forward.predict(state).values
    got = twin_values(forward, state, "power", 1.0)
    assert got is not None and np.abs(got - want).max() < 0.01 * want.max()


@pytest.mark.parametrize("follows", [True, False])
def test_contacts_move_as_far_as_images_show(follows: bool):
    still, claimed, state = seen("nothing").fitter, moving(1.2e-3), start()
    true = claimed if follows else still.forward
    rng = np.random.default_rng(3)
    images = true.mean @ true.predict(state).values + state.rest
    fitter = Fitter(claimed, images + 0.5 * rng.standard_normal(images.shape), still.priors)
    shown = model(session_as_shown(fitter, model))
    pressed = np.unique(claimed.row[claimed.row >= 0])
    reach = [
        np.linalg.norm(np.ptp(forward.within_m[forward.row == p], axis=0))
        for forward in (shown, claimed)
        for p in pressed
    ]
    part = np.array(reach[: len(pressed)]) / np.array(reach[len(pressed) :])
    # Of light presses the images show little.
    assert np.median(part) == pytest.approx(1.0 if follows else 0.0)
    assert part.mean() > 0.9 if follows else part.mean() < 0.2
