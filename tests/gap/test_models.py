"""Models whose presses were left in the wrong valley are mended, and others stay as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.made_sessions import OPTIONS, Made, made, pressed

from skincal.gap.candidates import Bench
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.models import Material, Model, begun_again, finished, fitted, found_again, levelled, pooled

AWAY = np.array([3e-4, -2e-4, 0.03, 0.3, -0.2])
HIDDEN = {"crosstalk": {"leak": 0.06}}


def with_crosstalk(one: Made, start: Hypothesis) -> Model:
    """The fit of the base model and a crosstalk from a start."""
    search = Bench(one.start, one.session).starts("crosstalk")[0]
    return fitted(start, search.coords, np.zeros(len(search.coords)), {}, wide(one))


def wide(one: Made) -> Material:
    """Places are measured to most of a millimetre."""
    return replace(one.material, options=replace(OPTIONS, position_sigma_m=8e-4))


def test_a_fit_that_ended_in_the_wrong_valleys_is_mended_once_the_effect_is_in_the_model():
    one = made(HIDDEN, pressed(24, 7), seed=3)
    best = with_crosstalk(one, one.truth).refit.objective
    places = one.truth.places.copy()
    places[:, :2] += 1.5e-3 * np.random.default_rng(1).choice([-1, 1], (len(places), 2))
    astray = with_crosstalk(one, one.truth.moved(AWAY).with_places(places))
    assert astray.refit.objective > 10 * best
    # From its own end nearly all are found; from another beginning a press or two may end in a valley that is worse.
    ways = (
        (found_again(astray, wide(one)), 1.05),
        (begun_again(astray, wide(one), one.start), 1.15),
    )
    for again, times in ways:
        assert again.refit.objective < times * best
        assert abs(float(again.hypothesis.effects["crosstalk"]["leak"]) - 0.06) < 0.002
        assert again.coords == astray.coords


def test_gains_that_share_a_factor_are_levelled_and_the_scale_has_it():
    one = made({"taxel_gain": {"gain": [1.1, 0.9, 1.0, 1.15, 1.0, 0.85, 0.95, 1.05, 1.1]}}, seed=5)
    (search,) = Bench(one.start, one.session).starts("taxel_gain")
    good = fitted(one.start, search.coords, np.zeros(9), {}, one.material)
    third = np.array([c.at((1 + 0.12 * x) / 3) for c, x in zip(search.coords, good.refit.x, strict=True)])
    there = good.hypothesis.moved(np.array([0.0, 0.0, 0.0, 0.0, np.log(3.0)]))
    still = replace(one.material, options=replace(one.material.options, steps=0))
    astray = fitted(there, search.coords, third, {}, still)
    # The same values, which only the prior of the gains likes less.
    assert np.allclose(astray.refit.slopes.residual, good.refit.slopes.residual)
    assert astray.refit.objective > good.refit.objective + 20
    again = levelled(astray, one.material)
    assert again.refit.objective == pytest.approx(good.refit.objective, abs=2.0)
    assert np.median(again.hypothesis.effects["taxel_gain"]["gain"]) == pytest.approx(1.0, abs=0.1)
    scales = (again.hypothesis.model.scale_per_n, one.truth.model.scale_per_n)
    assert scales[0] == pytest.approx(scales[1], rel=0.1)
    # Nothing is left to be done, nor where there are no gains.
    assert levelled(good, one.material) is good
    none = replace(astray, coords=())
    assert levelled(none, one.material) is none


def test_numbers_of_single_taxels_have_a_prior_as_wide_as_they_scatter():
    """A gain that is odd for sure stays; one of which hardly a press tells goes to where those of others are."""
    one = made({"taxel_gain": {"gain": [1.05, 0.95, 1.0, 1.05, 1.0, 0.95, 1.0, 1.05, 0.4]}}, seed=5)
    (search,) = Bench(one.start, one.session).starts("taxel_gain")
    good = fitted(one.start, search.coords, np.zeros(9), {}, one.material)
    again = pooled(good, one.material)
    assert [c.scatter for c in again.coords] == [1.0] * 9 and all(c.scatter is None for c in good.coords)
    odd = [float(m.hypothesis.effects["taxel_gain"]["gain"][8]) for m in (good, again)]
    assert odd[0] == pytest.approx(0.4, abs=0.04) and odd[1] == pytest.approx(odd[0], abs=0.03)
    # The counts of the first taxel are worth little, and twice what they should be.
    reading, first = one.material.reading, np.arange(9) == 0
    dim = replace(reading, counts=reading.counts * (1 + first), trust=np.where(first, 1e-4, reading.trust))
    blind = replace(one.material, reading=dim)
    loose = fitted(one.start, search.coords, np.zeros(9), {}, blind)
    tight = pooled(loose, blind)
    assert loose.refit.x[0] > 2.0 and 0.0 < tight.refit.x[0] < 0.4 * loose.refit.x[0]
    # A few numbers tell of no scatter, and effects without any of single taxels are left alone.
    few = replace(good, coords=search.coords[:5])
    assert pooled(few, one.material) is few
    assert pooled(with_crosstalk(one, one.start), one.material).coords[0].scatter is None


def test_a_fit_is_never_worse_for_having_been_looked_over():
    one = made(HIDDEN, pressed(24, 7), seed=4)
    good = with_crosstalk(one, one.start)
    assert found_again(good, wide(one)).refit.objective <= good.refit.objective


def test_the_fit_that_counts_goes_on_until_it_has_ended():
    one = made(HIDDEN, pressed(24, 7), seed=4)
    best = with_crosstalk(one, one.truth).refit.objective
    few = replace(wide(one), options=replace(wide(one).options, steps=2))
    search = Bench(one.start, one.session).starts("crosstalk")[0]
    short = fitted(one.start.moved(AWAY), search.coords, np.zeros(len(search.coords)), {}, few)
    assert short.refit.objective > best + 100
    assert finished(short, few).refit.objective < best + 20
    done = finished(with_crosstalk(one, one.start), wide(one))
    assert finished(done, wide(one)).refit.objective == pytest.approx(done.refit.objective, abs=5.0)
