"""The gap before and after: of the truth, of nothing better, and by whole presses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.made_sessions import Made, held, made

from skincal.gap.heldout import Gap, gap_closed
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.reading import Reading
from skincal.model.arrays import BoolArray

CROSSTALK = {"crosstalk": {"leak": 0.05}}


def everything(one: Made) -> BoolArray:
    return one.session.press >= 0


def without_effects(one: Made) -> Hypothesis:
    return one.truth.with_effects({})


def gap_of(
    one: Made,
    after: Hypothesis | None = None,
    rows: BoolArray | None = None,
    *,
    reading: Reading | None = None,
    seed: int = 0,
) -> Gap:
    rows = everything(one) if rows is None else rows
    reading = one.reading if reading is None else reading
    rng = np.random.default_rng(seed)
    return gap_closed(without_effects(one), after or one.truth, one.session, reading, rows, rng)


def test_the_truth_closes_the_gap():
    one = made(CROSSTALK)
    gap = gap_of(one)
    assert gap.closed == pytest.approx(1.0, abs=0.03)
    low, high = gap.interval
    assert 0.9 < low < gap.closed < high < 1.1
    assert gap.after == pytest.approx(gap.floor, rel=0.05) and gap.before > 1.5 * gap.floor
    assert (gap.presses, gap.frames) == (24, int(everything(one).sum()))


def test_the_interval_holds_one_for_the_truth_as_often_as_it_says():
    session = held()
    inside = []
    for seed in range(40):
        one = made(CROSSTALK, session, seed=seed)
        low, high = gap_of(one, seed=seed).interval
        inside.append(low <= 1.0 <= high)
    assert np.mean(inside) >= 0.82


def test_closed_is_what_its_definition_says():
    one = made(CROSSTALK)
    half = one.truth.with_effects({"crosstalk": {"leak": np.asarray(0.025)}})
    gap = gap_of(one, half)
    parts = [x**2 for x in (gap.before, gap.after, gap.floor)]
    assert gap.closed == pytest.approx((parts[0] - parts[1]) / (parts[0] - parts[2]))
    assert 0.6 < gap.closed < 0.85
    assert gap.errors.shape == (24, 4)
    assert np.sqrt(gap.errors[:, 0].sum() / gap.errors[:, 3].sum()) == pytest.approx(gap.before)


def test_the_same_model_closes_nothing_and_a_wrong_one_less():
    one = made(CROSSTALK)
    assert gap_of(one, without_effects(one)).closed == 0.0
    worse = one.truth.with_effects({"crosstalk": {"leak": np.asarray(0.2)}})
    assert gap_of(one, worse).closed < 0


def test_where_there_is_no_gap_nothing_is_said_to_be_closed():
    one = made()
    exact = one.reading.with_counts(one.reading.expected(one.truth.values(one.session)))
    gap = gap_of(one, reading=exact)
    assert gap.before < gap.floor
    assert np.isnan(gap.closed) and np.isnan(gap.interval).all()


def test_only_rows_that_are_asked_for_are_looked_at():
    one = made(CROSSTALK)
    rows = np.isin(one.session.press, [1, 4, 9])
    counts = one.reading.counts.copy()
    counts[~rows] += 100
    spoilt = gap_of(one, rows=rows, reading=one.reading.with_counts(counts))
    clean = gap_of(one, rows=rows)
    assert (spoilt.before, spoilt.after, spoilt.closed) == (clean.before, clean.after, clean.closed)
    assert (clean.presses, clean.frames) == (3, int(rows.sum()))


def test_what_was_not_read_is_not_counted():
    one = made(CROSSTALK)
    counts = one.reading.counts.copy()
    counts[:, 5] = np.nan
    reading = Reading.of(replace(one.session, counts=counts), one.reading.sigma_counts, one.reading.readout)
    gap = gap_of(one, reading=reading)
    assert np.isfinite([gap.before, gap.after, gap.floor, gap.closed]).all()
    assert gap.errors[:, 3].sum() == 8 * everything(one).sum()


def test_a_press_of_which_nothing_was_read_says_nothing_however_often_it_is_drawn():
    one = made(CROSSTALK)
    counts = one.reading.counts.copy()
    counts[one.session.press == 4] = np.nan
    reading = Reading.of(replace(one.session, counts=counts), one.reading.sigma_counts, one.reading.readout)
    both, alone = (
        gap_of(one, rows=np.isin(one.session.press, some), reading=reading) for some in ([1, 4], [1])
    )
    assert np.isfinite(both.added).all()
    assert (both.before, both.after, both.closed) == (alone.before, alone.after, alone.closed)
    # Nor does it make four of one, of which something is sure.
    assert both.presses == alone.presses == len(both.errors) == 1
    assert both.added == alone.added


def test_slack_is_what_presses_moved():
    one = made(CROSSTALK)
    moved = one.truth.with_places(one.truth.places + np.array([3e-4, 0.0, 0.0]))
    gap = gap_of(one, moved)
    for value, hypothesis in ((gap.slack_before_m, one.truth), (gap.slack_after_m, moved)):
        assert value == pytest.approx(np.sqrt((hypothesis.places[:, :2] ** 2).sum(axis=1).mean()))


def test_same_seed_same_interval():
    one = made(CROSSTALK)
    assert gap_of(one, seed=3).interval == gap_of(one, seed=3).interval
    assert gap_of(one, seed=3).interval != gap_of(one, seed=4).interval


@pytest.mark.parametrize(
    ("before", "after", "added", "refuted"),
    [
        (1.0, 2.0, (1.0, 5.0), True),  # surely, and by far
        (1.0, 1.4, (-0.1, 3.0), False),  # not surely
        (1.0, 2.0, (-0.1, 6.0), True),  # one press, but by far
        (1.004, 1.012, (0.015, 0.017), False),  # next to nothing, however sure
        (0.98, 1.1, (0.2, 0.3), True),  # no gap was there at all
        (2.0, 1.0, (-4.0, -2.0), False),
    ],
)
def test_presses_that_are_surely_further_off_refute(
    before: float, after: float, added: tuple[float, float], refuted: bool
):
    none = (float("nan"), float("nan"))
    gap = Gap(before, after, 0.99, 0.0, none, added, 9, 100, 0.0, 0.0, np.zeros((9, 4)))
    assert gap.refutes(0.15) is refuted


@pytest.mark.parametrize(
    ("before", "interval", "stays"),
    [
        (1.2, (-0.02, 0.03), True),
        (1.2, (-0.02, 0.3), False),  # perhaps some of it
        (1.01, (-0.02, 0.03), False),  # hardly any gap
        (1.2, (float("nan"), float("nan")), False),
    ],
)
def test_a_gap_that_surely_is_not_closed_stays_open(
    before: float, interval: tuple[float, float], stays: bool
):
    gap = Gap(before, before, 1.0, 0.0, interval, (0.0, 0.0), 9, 100, 0.0, 0.0, np.zeros((9, 4)))
    assert gap.leaves_open(0.1, 0.3) is stays


@pytest.mark.parametrize(
    ("before", "interval", "stays"),
    [
        (6.0, (-0.1, 0.4), True),  # most of six times the noise
        (6.0, (0.4, 0.7), False),
        (
            1.5,
            (-0.1, 0.4),
            False,
        ),  # as little of what is hardly more than the noise: the rest may be any of many things
        (1.5, (-0.1, 0.05), True),
    ],
)
def test_of_a_large_gap_more_must_be_closed(before: float, interval: tuple[float, float], stays: bool):
    gap = Gap(before, before, 1.0, 0.0, interval, (0.0, 0.0), 9, 100, 0.0, 0.0, np.zeros((9, 4)))
    assert gap.stays_open() is stays
    # What the contact law leaves is no gap that an effect could close.
    assert not gap.stays_open(law=before)


def test_what_the_contact_law_leaves_open_no_effect_can_close():
    before = float(np.sqrt(1 + 1.0**2 + 0.4**2))
    gap = Gap(before, before, 1.0, 0.08, (0.05, 0.09), (0.0, 0.0), 9, 100, 0.0, 0.0, np.zeros((9, 4)))
    assert gap.leaves_open(0.1, 0.3)
    # Of what the law does not make, a half is closed, or there is nothing.
    assert not gap.leaves_open(0.1, 0.3, law=1.0)
    assert not gap.leaves_open(0.1, 0.3, law=1.05)


@pytest.mark.parametrize("presses", [3, 4])
def test_fewer_than_four_presses_refute_nothing_and_leave_nothing_open(presses: int):
    gap = Gap(1.2, 2.0, 1.0, 0.0, (-9.0, -3.0), (1.0, 4.0), presses, 100, 0.0, 0.0, np.zeros((presses, 4)))
    assert gap.refutes(0.5) is gap.leaves_open(0.1, 0.3) is (presses == 4)
