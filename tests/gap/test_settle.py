"""Downhill only: a press that a step leads over its valley goes back, and does not keep the others from going on."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from gap.made_sessions import MODEL, OPTIONS, Effects, Made, made

from skincal.effects import Contacted, EffectSkin
from skincal.gap.downhill import damped, uphill
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.problem import cost_of_presses
from skincal.gap.refit import refit
from skincal.gap.settle import settled

WIDE = replace(OPTIONS, position_sigma_m=1e-3)
STIFF = replace(MODEL, elasticity_pa_per_m=1.2e9)
"""Contacts are narrower than taxels are apart: images change by jumps."""


def astray(effects: Effects) -> tuple[Made, Hypothesis]:
    """A session on a stiff skin, presses a millimetre from where they were, and a model without what is there."""
    one = made(effects, model=STIFF)
    places = one.truth.places.copy()
    places[:, :2] += np.random.default_rng(2).normal(0, 1e-3, places[:, :2].shape)
    return one, Hypothesis(STIFF, places)


def test_no_press_goes_uphill_in_any_step(monkeypatch: pytest.MonkeyPatch):
    one, start = astray({})

    def risen() -> int:
        """How often a press costs more after a step than before it."""
        ends = [settled(start, one.session, one.reading, WIDE, steps) for steps in range(7)]
        costs = [cost_of_presses(end, left, one.session, WIDE) for end, left in ends]
        return sum(int(uphill(before, after).sum()) for before, after in itertools.pairwise(costs))

    assert risen() == 0
    monkeypatch.setattr("skincal.gap.settle.uphill", lambda here, _: np.zeros(len(here), dtype=bool))
    # Were steps not taken back, some would: this is a case of it.
    assert risen() > 0


def test_a_fit_goes_on_though_some_presses_jump(monkeypatch: pytest.MonkeyPatch):
    one, start = astray({"stiffening": {"exponent": 1.8}})

    def left(steps: int) -> float:
        return refit(start, one.session, one.reading, replace(WIDE, steps=steps, enough=0.01)).objective

    best, found = left(40), left(12)
    assert found < 1.1 * best
    monkeypatch.setattr("skincal.gap.refit.damped", lambda own, _: np.zeros(len(own)))
    # Where a step is shortened for all presses alike, it is kept so short that the fit ends far off.
    assert left(12) > 3 * best


def test_a_press_that_loses_its_image_goes_uphill_and_one_that_gets_it_back_does_not():
    before, after = np.array([np.nan, 10.0, 10.0, 10.0]), np.array([50.0, 10.1, 12.0, np.nan])
    assert uphill(before, after).tolist() == [False, False, True, True]


def test_damping_grows_as_long_as_a_press_goes_uphill_and_is_gone_after():
    own = np.zeros(2)
    seen: list[float] = []
    for wrong in (True, True, False):
        own = damped(own, np.array([wrong, False]))
        seen.append(float(own[0]))
        assert own[1] == 0.0
    assert 0 < seen[0] < seen[1]
    assert seen[2] == 0.0


@pytest.mark.parametrize("learned", [True, False])
def test_a_press_without_an_image_comes_back_and_spoils_nothing(
    monkeypatch: pytest.MonkeyPatch, learned: bool
):
    one = made()
    along = one.truth.placed(one.session).samples.contacts.points_m[:, 1]
    last = int(one.session.row[np.argmax(along)])
    rim, finish = float(along.max()) + 4e-4, EffectSkin.finish

    def ending(self: EffectSkin, contacted: Contacted) -> np.ndarray:
        """A skin that ends at a rim."""
        out = finish(self, contacted).copy()
        out[contacted.samples.touching & (contacted.samples.contacts.points_m[:, 1] > rim)] = np.nan
        return out

    monkeypatch.setattr(EffectSkin, "finish", ending)
    places = one.truth.places.copy()
    places[last, 1] += 1e-3
    start = one.truth.with_places(places)
    assert np.isnan(start.values(one.session)).any()
    end, left = settled(start, one.session, one.reading, OPTIONS, 8)
    assert np.isfinite(end.places).all() and np.isfinite(left).all()
    np.testing.assert_allclose(end.places[last, :2], one.truth.places[last, :2], atol=2e-4)
    known = None if learned else one.session.press != last
    found, whole = (
        refit(at, one.session, one.reading, replace(OPTIONS, steps=14), learn=known)
        for at in (start, one.truth)
    )
    assert found.objective == pytest.approx(whole.objective, abs=5.0)
    assert np.isfinite(found.hypothesis.places).all()
