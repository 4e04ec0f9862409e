"""A hypothesis moves the sensor, presses and forces as it says, on any surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.gap_sessions import static
from gap.made_sessions import LAYOUT, MODEL, held, made, pressed
from model.model_shapes import FINGER, cylinder_mesh, surface_of

from skincal.effects import Steps, hold_session, hold_times
from skincal.gap.base import BaseModel
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.session import of_holds
from skincal.model import Plane, SensorPose, Surface

SURFACES = {
    "cylinder": (FINGER, SensorPose(0.0235, 0.3, 0.1)),
    "plane": (Plane(), SensorPose(0.0235, 0.3, x_m=0.002)),
    "mesh": (surface_of(cylinder_mesh(64, open_base=True)), SensorPose(0.0235, 0.3, 0.1)),
}
HYSTERESIS = {"hysteresis": {"height": np.asarray(0.5)}}


def on(surface: Surface, pose: SensorPose) -> Hypothesis:
    return Hypothesis(BaseModel(surface, LAYOUT, pose, 4e8, 70.0, resolution_m=1.5e-3), np.zeros((1, 3)))


def centre(hypothesis: Hypothesis) -> np.ndarray:
    return hypothesis.model.surface.wrap(hypothesis.model.pose, np.zeros((1, 2)))[0][0]


@pytest.mark.parametrize("kind", SURFACES)
def test_the_sensor_moves_as_far_as_it_says_however_it_is_turned(kind: str):
    here = on(*SURFACES[kind])
    across, along = (centre(here.moved(np.array([*s, 0, 0, 0]))) for s in ((5e-4, 0), (0, 5e-4)))
    # A mesh has flat facets, so a step on it is not quite that on the round finger.
    assert np.linalg.norm(across - centre(here)) == pytest.approx(5e-4, rel=0.02)
    assert along - centre(here) == pytest.approx([0, 5e-4, 0], abs=2e-6)
    assert (across - centre(here))[0] > 4.5e-4 and abs((across - centre(here))[1]) < 2e-6
    back = here.moved(np.array([5e-4, -3e-4, 0.1, 0.2, -0.1])).moved(np.array([-5e-4, 3e-4, -0.1, -0.2, 0.1]))
    assert centre(back) == pytest.approx(centre(here), abs=5e-6)
    assert back.model.pose.alpha_rad == pytest.approx(0.3)
    assert back.model.elasticity_pa_per_m == pytest.approx(4e8)
    assert back.model.scale_per_n == pytest.approx(70.0)


def test_a_sensor_that_moves_is_presses_that_move_the_other_way():
    session = pressed()
    here = Hypothesis(MODEL, np.zeros((session.presses, 3)))
    step = np.array([2e-4, -3e-4])
    moved = here.moved(np.array([*step, 0, 0, 0])).values(session)
    shifted = here.with_places(np.tile([*-step, 0.0], (session.presses, 1))).values(session)
    assert np.abs(moved - here.values(session)).max() > 5
    assert moved == pytest.approx(shifted, abs=0.02)


def test_scale_and_elasticity_by_logarithms():
    session = pressed()
    here = Hypothesis(MODEL, np.zeros((session.presses, 3)))
    more = here.moved(np.array([0, 0, 0, 0, 0.1]))
    assert more.values(session) == pytest.approx(here.values(session) * np.exp(0.1))
    # Loads are F times a function of F / E.
    softer = here.moved(np.array([0, 0, 0, -0.2, 0.2]))
    harder = here.with_places(np.tile([0, 0, 0.2], (session.presses, 1)))
    assert harder.values(session) == pytest.approx(softer.values(session), abs=1e-6)
    per_taxel = replace(MODEL, scale_per_n=np.linspace(50, 90, 9))
    assert Hypothesis(per_taxel, here.places).moved(np.array([0, 0, 0, 0, 0.1])).model.scale_per_n == (
        pytest.approx(np.linspace(50, 90, 9) * np.exp(0.1))
    )


def test_a_press_that_moves_takes_all_its_samples_along_and_nothing_else():
    session = pressed()
    places = np.zeros((session.presses, 3))
    places[4] = [3e-4, -4e-4, 0.1]
    before = session.samples.contacts
    after = Hypothesis(MODEL, places).placed(session).samples.contacts
    own = session.row == 4
    assert np.linalg.norm(after.points_m - before.points_m, axis=1)[own] == pytest.approx(5e-4, rel=0.01)
    assert after.force_n[own] == pytest.approx(before.force_n[own] * np.exp(0.1))
    assert (after.points_m[~own] == before.points_m[~own]).all()
    assert (after.force_n[~own] == before.force_n[~own]).all()


def test_other_places_keep_the_skin_and_say_the_same():
    one = made(HYSTERESIS)
    values = one.truth.values(one.session)
    elsewhere = one.truth.with_places(np.zeros_like(one.truth.places))
    assert elsewhere.skin is one.truth.skin
    fresh = Hypothesis(MODEL, np.zeros_like(one.truth.places), one.truth.effects)
    assert (elsewhere.values(one.session) == fresh.values(one.session)).all()
    assert (elsewhere.with_places(one.truth.places).values(one.session) == values).all()
    assert (elsewhere.with_effects({}).values(one.session) != fresh.values(one.session)).any()


def test_presses_without_frames_do_not_remember_each_other():
    session = static(12, clock=True)
    samples = session.samples
    holds = replace(samples, time_s=None, phase=None)[np.flatnonzero(session.observation >= 0)[::4]]
    order = np.random.default_rng(0).permutation(12)
    other = of_holds(hold_session(holds[order], hold_times(12), Steps(5, 4, 5)), None, clock=True)
    lasting = {
        "creep": {"amplitude": np.asarray(0.3), "time_constant_s": np.asarray(50.0)},
        **HYSTERESIS,
    }
    one, two = (Hypothesis(MODEL, np.zeros((12, 3)), lasting).values(s) for s in (session, other))
    # What was before the first press is not known.
    later = (np.arange(12) > 0) & (order > 0)
    assert two[later] == pytest.approx(one[order][later], abs=1e-6)
    assert two == pytest.approx(one[order], rel=0.005, abs=0.01)
    base = Hypothesis(MODEL, np.zeros((12, 3))).values(session)
    assert np.abs(one - base).max() > 0.5


def test_sessions_without_covariates_abstain():
    session = held()
    lacking = {"shear": {"shift_m_per_n": np.asarray(5e-4)}, "gain_drift": {"rate_per_s": np.asarray(1e-3)}}
    here = Hypothesis(MODEL, np.zeros((session.presses, 3)))
    assert (here.with_effects(lacking).values(session) == here.values(session)).all()
