"""Glitch presses, taxels that die and taxels that jump are found for what they are, and nothing else is."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap.gap_sessions import READOUT, without
from gap.made_sessions import MODEL, OPEN, SIGMA, Made, held, made, pressed, read

from skincal.fit.observe import Readout
from skincal.gap.reading import Reading
from skincal.gap.robust import (
    Dead,
    Jump,
    dead_taxels,
    dominating,
    explained,
    glitches,
    jumps,
    of_neither,
    others_differ,
    too_many,
    without_jumps,
    without_presses,
)
from skincal.gap.session import GapSession

PRESSES, EACH = 20, 10
GROUP = [0, 3, 6]


def noise_of(scale: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whitened residuals of presses with so many times the noise, where they were read, and their presses."""
    press = np.repeat(np.arange(len(scale)), EACH)
    residual = np.random.default_rng(seed).standard_normal((len(press), 9)) * scale[press, None]
    rest = 30.0 * np.ones((4, 9))
    seen = np.ones((len(press) + 4, 9), dtype=bool)
    return np.vstack([residual, rest]), seen, np.append(press, [-1] * 4)


def test_a_glitch_press_is_found_and_no_other():
    scale = np.ones(PRESSES)
    scale[7] = 5.0
    assert glitches(*noise_of(scale)).tolist() == [7]
    assert glitches(*noise_of(np.ones(PRESSES))).tolist() == []


def test_a_press_is_a_glitch_beside_the_others_not_by_itself():
    scale = np.full(PRESSES, 4.0)
    scale[7] = 8.0
    assert glitches(*noise_of(scale)).tolist() == []
    scale[7] = 20.0
    assert glitches(*noise_of(scale)).tolist() == [7]


def test_a_glitch_that_hid_behind_what_was_missing_is_found_with_it():
    much = np.full(PRESSES, 6.0)
    much[[7, 15]] = 8.0
    before, seen, press = noise_of(much)
    assert glitches(before, seen, press).tolist() == []
    little = np.ones(PRESSES)
    little[7] = 8.0
    assert of_neither(before, noise_of(little)[0], seen, press).tolist() == [7]
    # Which the better model alone does not know is no glitch, nor is what many presses do.
    few = np.ones(PRESSES)
    few[7] = 1.2
    assert of_neither(noise_of(few)[0], noise_of(little)[0], seen, press).tolist() == []
    many = np.ones(PRESSES)
    many[: PRESSES // 4] = 8.0
    assert of_neither(before, noise_of(many)[0], seen, press).tolist() == []


def test_what_many_presses_do_is_no_glitch():
    scale = np.ones(3 * PRESSES)
    scale[[7, 20, 33]] = 6.0
    assert glitches(*noise_of(scale)).tolist() == [7, 20, 33]
    scale[[40]] = 6.0
    assert glitches(*noise_of(scale)).tolist() == []
    few = np.ones(6)
    few[2] = 50.0
    assert glitches(*noise_of(few)).tolist() == []


def test_presses_that_are_too_many_to_be_glitches_are_told_and_stay():
    residual = np.random.default_rng(4).normal(size=(120, 4))
    press, seen = np.repeat(np.arange(40), 3), np.ones((120, 4), dtype=bool)
    for wild, expected in ((2, 0), (3, 3)):
        off = np.where(press < wild, 30.0, 1.0)[:, None]
        assert len(glitches(residual * off, seen, press)) == wild - expected
        assert too_many(residual * off, seen, press).tolist() == list(range(expected))


def test_one_press_that_holds_much_of_all_that_is_left_dominates():
    scale = np.ones(4 * PRESSES)
    scale[7] = 2.2
    assert dominating(*noise_of(scale)).tolist() == [7]
    assert glitches(*noise_of(scale)).tolist() == []
    scale[7] = 1.4
    assert dominating(*noise_of(scale)).tolist() == []


def test_what_many_presses_show_is_not_left_out_for_dominating():
    scale = np.ones(4 * PRESSES)
    scale[::8] = 2.2
    assert dominating(*noise_of(scale)).tolist() == []
    scale[7], scale[9], scale[11] = 8.0, 7.5, 7.0
    assert len(dominating(*noise_of(scale))) == 2


def test_few_presses_are_all_kept():
    scale = np.ones(6)
    scale[2] = 50.0
    assert dominating(*noise_of(scale)).tolist() == []


def test_a_press_counts_by_what_was_read_of_it():
    scale = np.ones(PRESSES)
    scale[7] = 5.0
    residual, seen, press = noise_of(scale)
    seen[press == 7, 2:] = False
    residual[~seen] = 0.0
    assert glitches(residual, seen, press).tolist() == [7]
    seen[press == 7], residual[press == 7] = False, 0.0
    assert glitches(residual, seen, press).tolist() == []


def test_others_differ_by_far_more_than_noise_or_not_at_all():
    scale = np.ones(3 * PRESSES)
    assert not others_differ(*noise_of(scale))
    scale[7] = 1.6
    assert not others_differ(*noise_of(scale))
    scale[7] = 2.2
    residual, seen, press = noise_of(scale)
    assert others_differ(residual, seen, press)
    seen[press == 7], residual[press == 7] = False, 0.0
    assert not others_differ(residual, seen, press)


def test_presses_are_explained_by_what_takes_most_of_them_and_leaves_them_in_proportion():
    scale = np.ones(2 * PRESSES)
    scale[[3, 7, 9]] = 6.0
    before, seen, press = noise_of(scale)
    # So many are no glitches any more, but that does not explain them.
    assert glitches(before, seen, press).tolist() == []
    assert not explained(before, before, seen, press, np.array([3, 7, 9]))
    for left, wanted in ((1.0, True), (3.0, True), (5.0, False)):
        scale[[3, 7, 9]] = left
        after = noise_of(scale)[0]
        assert explained(before, after, seen, press, np.array([3, 7, 9])) is wanted
    # Less than before, but still out of all proportion.
    scale[[3, 7, 9]] = 20.0
    before = noise_of(scale)[0]
    scale[[3, 7, 9]] = 1.0, 1.0, 8.0
    assert not explained(before, noise_of(scale)[0], seen, press, np.array([3, 7, 9]))
    assert explained(before, noise_of(scale)[0], seen, press, np.array([3, 7]))
    seen[press == 9] = False
    assert explained(before, noise_of(scale)[0], seen, press, np.array([3, 9]))


def test_a_reading_without_presses_has_none_of_them():
    one = made()
    less = without_presses(one.reading, one.session.press, np.array([2, 5]))
    gone = np.isin(one.session.press, [2, 5])
    assert not less.seen[gone].any()
    assert np.array_equal(less.trust[~gone], one.reading.trust[~gone])


@cache
def calm(readout: Readout = READOUT) -> Made:
    """A session without anything, its rest looked at for twenty frames a time."""
    session = pressed()
    session = replace(session, frames=np.where(session.press < 0, 20.0, session.frames))
    return made(session=session, model=replace(MODEL, readout=readout))


def seen_as(one: Made, values: np.ndarray) -> Reading:
    """The reading of other values (N, J) in the same session."""
    readout = one.truth.model.readout
    counts = read(one.session, values, np.random.default_rng(8), readout)
    return Reading.of(replace(one.session, counts=counts), SIGMA, readout)


def start_of(session: GapSession, press: int) -> int:
    return int(np.flatnonzero(session.press == press)[0])


@cache
def reached() -> int:
    """The taxel that most presses of the second half reach."""
    one = calm()
    late = np.arange(len(one.session)) >= start_of(one.session, 12)
    lit = (one.truth.values(one.session) > 20) & late[:, None]
    return int(np.argmax([len(np.unique(one.session.press[own])) for own in lit.T]))


def dying(
    taxel: int, press: int | None, reads: float, answer: float = 0.0
) -> tuple[Made, np.ndarray, Reading]:
    """A session in which a taxel does not answer from a press on."""
    one = calm()
    values = one.truth.values(one.session)
    first = 0 if press is None else start_of(one.session, press)
    bad = values.copy()
    bad[first:, taxel] = answer * bad[first:, taxel] + (1 - answer) * reads
    return one, values, seen_as(one, bad)


@pytest.mark.parametrize(("press", "reads", "answer"), [(12, 0.0, 0.0), (7, 17.0, 0.0), (12, 9.0, 0.1)])
def test_a_taxel_that_dies_half_way_is_found_with_its_press(press: int, reads: float, answer: float):
    one, values, reading = dying(reached(), press, reads, answer)
    (dead,) = dead_taxels(values, reading, one.session)
    assert dead.taxel == reached()
    # Presses that do not reach the taxel cannot say whether it was dead already.
    rows = [int(np.searchsorted(one.session.samples.elapsed_s, dead.from_s)), start_of(one.session, press)]
    assert one.session.samples.elapsed_s[rows[0]] == dead.from_s
    assert values[min(rows) : max(rows), reached()].max(initial=0.0) < 5.0
    if reads > 5:
        assert rows[0] == rows[1]
    assert dead.stuck_counts == pytest.approx(reads, abs=1.0)
    assert dead.answer == pytest.approx(answer, abs=0.03)


def test_a_taxel_that_never_answers_is_dead_from_zero():
    one, values, reading = dying(reached(), None, 0.0)
    (dead,) = dead_taxels(values, reading, one.session)
    assert (dead.taxel, dead.from_s) == (reached(), 0.0)


def test_without_a_clock_a_dead_taxel_has_the_number_of_its_observation():
    one, values, reading = dying(reached(), 12, 17.0)
    session = without(one.session, time_s=None)
    (dead,) = dead_taxels(values, reading, session)
    assert dead.from_s == start_of(session, 12)


def test_what_answers_weakly_or_is_hardly_reached_is_not_dead():
    one = calm()
    values = one.truth.values(one.session)
    assert dead_taxels(values, seen_as(one, values), one.session) == []
    assert dead_taxels(values, seen_as(one, values * 0.5), one.session) == []
    # Taxel 2 is hardly reached by any press: nobody can tell.
    assert values[:, 2].max() < 5
    assert dead_taxels(values, dying(2, None, 0.0)[2], one.session) == []


def test_a_model_that_is_wrong_everywhere_makes_no_taxel_dead():
    one = calm()
    values = one.truth.values(one.session)
    assert dead_taxels(values, seen_as(one, 0.0 * values), one.session) == []


def test_what_was_never_read_is_not_called_dead():
    one = calm()
    values = one.truth.values(one.session)
    counts = one.reading.counts.copy()
    counts[:, reached()] = np.nan
    reading = Reading.of(replace(one.session, counts=counts), SIGMA, READOUT)
    assert dead_taxels(values, reading, one.session) == []


def jumping(height: float, press: int, step: int, readout: Readout = READOUT) -> tuple[Made, Reading]:
    """Three taxels whose level jumps in a press, at one of its observations."""
    one = calm(readout)
    values = one.truth.values(one.session)
    values[np.ix_(np.arange(len(values)) >= start_of(one.session, press) + step, GROUP)] += height
    return one, seen_as(one, values)


def jumps_of(one: Made, reading: Reading, dead: list[Dead] | None = None) -> list[Jump]:
    return jumps(one.truth.values(one.session), reading, one.session, dead or [])


@pytest.mark.parametrize(("height", "readout"), [(3.0, READOUT), (10.0, READOUT), (5.0, OPEN), (-5.0, OPEN)])
def test_taxels_that_jump_together_are_one_jump(height: float, readout: Readout):
    one, reading = jumping(height, 12, 0, readout)
    (jump,) = jumps_of(one, reading)
    assert jump.taxels == tuple(GROUP)
    # At a clipped rest, too: as high as it is under load, where a press looked at for longer shows it.
    assert jump.counts == pytest.approx([height] * 3, abs=0.2)
    assert jump.at_s == one.session.samples.elapsed_s[start_of(one.session, 12)]


def test_a_jump_in_a_press_is_found_where_it_was():
    one, reading = jumping(10.0, 9, 4)
    (jump,) = jumps_of(one, reading)
    assert jump.at_s == one.session.samples.elapsed_s[start_of(one.session, 9) + 4]


@pytest.mark.parametrize("height", [3.0, 10.0])
def test_taken_off_a_jump_leaves_noise(height: float):
    one, reading = jumping(height, 12, 0)
    values = one.truth.values(one.session)
    mended = without_jumps(reading, one.session, jumps_of(one, reading))
    late = np.arange(len(values)) >= start_of(one.session, 12)
    assert np.array_equal(mended.counts, reading.counts)
    others = [j for j in range(9) if j not in GROUP]
    assert not mended.lift[~late].any() and not mended.lift[:, others].any()
    rest = one.session.press < 0
    # What is expected jumps, and is clipped after that: a taxel at rest reads as high as it does.
    shown = mended.expected(values)
    assert (mended.counts - shown)[np.ix_(late & rest, GROUP)].mean() == pytest.approx(0.0, abs=0.03)
    for rows in (late & rest, late & ~rest):
        left = mended.residual(values)[np.ix_(rows, GROUP)]
        assert (left**2).mean() == pytest.approx(1.0, abs=3 * np.sqrt(2 / left.size))
        assert (reading.residual(values)[np.ix_(rows, GROUP)] ** 2).mean() > 5


def test_an_observation_in_which_a_jump_happens_says_nothing_of_its_height():
    one, reading = jumping(6.0, 12, 0)
    first = start_of(one.session, 12)
    counts = reading.counts.copy()
    # The rest before it, half of it already jumped.
    counts[np.ix_([first - 1], GROUP)] += 3.0
    (jump,) = jumps_of(one, replace(reading, counts=counts))
    (plain,) = jumps_of(one, reading)
    left_out = np.delete(np.arange(len(counts)), first - 1)
    assert jump.counts == pytest.approx(plain.counts, abs=0.2)
    trusted = without_jumps(replace(reading, counts=counts), one.session, [jump]).trust
    assert not trusted[np.ix_([first - 1], GROUP)].any()
    assert (trusted[left_out].min(axis=1) > 0).sum() >= len(left_out) - 2


def test_jumps_at_two_moments_are_two():
    one = calm()
    values = one.truth.values(one.session)
    for taxel, press, height in ((1, 6, 8.0), (4, 15, 4.0)):
        values[start_of(one.session, press) :, taxel] += height
    first, second = jumps_of(one, seen_as(one, values))
    assert (first.taxels, second.taxels) == ((1,), (4,))
    assert (*first.counts, *second.counts) == pytest.approx((8.0, 4.0), abs=0.2)
    assert first.at_s < second.at_s


def test_a_slow_drift_is_no_jump():
    one = calm()
    share = np.linspace(0.0, 1.0, len(one.session))[:, None]
    for course in (10 * share, 10 * share**2, 6 * np.sin(2 * share)):
        reading = seen_as(one, one.truth.values(one.session) + course)
        assert jumps_of(one, reading) == []
    assert jumps_of(one, one.reading) == []


def test_a_press_without_an_image_does_not_hide_that_a_taxel_is_dead():
    one, values, reading = dying(reached(), None, 3.0)
    lost = values.copy()
    lost[one.session.press == 4] = np.nan
    (plain,) = dead_taxels(values, reading, one.session)
    (found,) = dead_taxels(lost, reading, one.session)
    assert (found.taxel, found.from_s) == (plain.taxel, plain.from_s)


def test_a_dead_taxel_does_not_jump_as_well():
    one, values, reading = dying(reached(), 12, 17.0)
    dead = dead_taxels(values, reading, one.session)
    assert [j.taxels for j in jumps_of(one, reading)] == [(reached(),)]
    assert jumps_of(one, reading, dead) == []


def test_presses_without_rest_show_no_jump():
    one = made(session=held())
    late = one.reading.counts.copy()
    late[15:] += 10
    assert jumps_of(one, one.reading.with_counts(late)) == []
