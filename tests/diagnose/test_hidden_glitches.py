"""Glitches among the presses of the end that hid behind what was missing have no say in the gap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from gap.made_sessions import CASES, OPTIONS, Made, made

from skincal.diagnose.base_fit import Base, without_hidden_glitches
from skincal.diagnose.second_look import taken_back
from skincal.diagnose.workflow import _deviation as noise_of_fitted
from skincal.gap.choice import Choice, Named
from skincal.gap.models import Model
from skincal.gap.refit import refit
from skincal.gap.robust import without_presses

SPOILED_COUNTS = 6.0


def spoiled(one: Made, press: int) -> Made:
    """The session with every second taxel off in one press."""
    counts = one.reading.counts.copy()
    counts[one.session.press == press, ::2] += SPOILED_COUNTS
    session = replace(one.session, counts=counts)
    return Made(session, one.reading.with_counts(counts), one.truth)


def models(one: Made) -> tuple[Base, Model]:
    """The true sensor without its effects, and with them."""
    still = replace(OPTIONS, settle=4, steps=4, base=False)
    before, after = (
        Model(refit(one.start, one.session, one.reading, still, fixed=effects))
        for effects in ({}, one.truth.effects)
    )
    none = np.zeros(0, dtype=np.int64)
    return Base(before, one.material, none, (), ()), after


def test_one_of_the_end_is_left_out():
    one = made(CASES["crosstalk"])
    known, press = one.material.known, one.session.press
    learned = np.unique(press[known & (press >= 0)])
    (*_, last) = np.setdiff1d(press[press >= 0], learned).tolist()
    base, after = models(spoiled(one, last))
    found = without_hidden_glitches(base, after)
    assert found.glitches.tolist() == [last]
    assert not found.material.reading.seen[press == last].any()
    assert (found.material.reading.seen == base.material.reading.seen)[press != last].all()


def test_one_that_was_learned_from_stays():
    one = made(CASES["crosstalk"])
    known, press = one.material.known, one.session.press
    first = int(np.unique(press[known & (press >= 0)])[0])
    base, after = models(spoiled(one, first))
    assert without_hidden_glitches(base, after) is base


def test_nothing_is_left_out_where_nothing_is_wrong():
    base, after = models(made(CASES["crosstalk"]))
    assert without_hidden_glitches(base, after) is base


def test_presses_that_fit_once_an_effect_is_named_are_taken_back_and_glitches_are_not():
    # As the loop of a strong effect is: out of all proportion as long as it is not in the model.
    one = spoiled(made({"crosstalk": {"leak": 0.06}}), 5)
    base, after = models(one)
    after = replace(after, held=one.truth.effects)
    press = one.session.press
    own = [float((base.model.refit.slopes.residual[press == k] ** 2).mean()) for k in range(press.max() + 1)]
    learned = np.unique(press[one.material.known & (press >= 0)])
    strongest = next(int(k) for k in np.argsort(own)[::-1] if k != 5 and k in learned)
    out = np.sort(np.array([strongest, 5]))
    reading = without_presses(one.reading, press, out)
    base = replace(base, material=replace(base.material, reading=reading), glitches=out)
    choice = Choice(base.model, after, (Named("crosstalk", ("crosstalk",), 0.9, 0.01),), (), (1000.0, 10.0))
    found, chosen = taken_back(base, choice)
    assert found.glitches.tolist() == [5]
    assert found.material.reading.seen[press == strongest].any()
    assert not found.material.reading.seen[press == 5].any()
    assert found.model is chosen.before and chosen.after.names == ("crosstalk",)
    # The sensor that the base model found stays: what was read off beside it would bend it.
    assert chosen.before.hypothesis.model == base.model.hypothesis.model
    # Of the end it would be chosen by what was named.
    end = replace(base, material=replace(base.material, learn=base.material.learn & (press != strongest)))
    end = replace(end, material=replace(end.material, score=base.material.score & (press != strongest)))
    assert taken_back(end, choice)[0].glitches.tolist() == out.tolist()
    unnamed = replace(choice, named=())
    assert taken_back(base, unnamed) == (base, unnamed)


def test_noise_of_what_was_fitted_is_that_of_means_of_frames():
    """A law's part is told in it; in the noise of single frames it would count for more than it is."""
    one = made(CASES["crosstalk"])
    base, _ = models(one)
    single = replace(one.reading, frames=np.ones_like(one.reading.frames))
    seen = one.reading.seen & one.material.known[:, None]
    of_one = np.sqrt((single.deviation(base.model.refit.slopes.values)[seen] ** 2).mean())
    # Two frames of a ramp and six of a hold.
    assert of_one / np.sqrt(6) < noise_of_fitted(base.model, base) < of_one / np.sqrt(2) * (1 + 1e-9)
