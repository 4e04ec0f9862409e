"""Glitches among the presses of the end that hid behind what was missing have no say in the gap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from gap.made_sessions import CASES, OPTIONS, Made, made

from skincal.diagnose.base_fit import Base, without_hidden_glitches
from skincal.gap.models import Model
from skincal.gap.refit import refit

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
