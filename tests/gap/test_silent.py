"""A taxel that dies in one of the last presses is told from a glitch, and named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap.gap_sessions import READOUT, without
from gap.made_sessions import OPTIONS, SIGMA, Made, made, read

from skincal.diagnose.base_fit import Base
from skincal.diagnose.second_look import heard_again, silent_beside
from skincal.gap.choice import Choice
from skincal.gap.dying import NAME, with_silent
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.models import Model
from skincal.gap.null import Null
from skincal.gap.reading import Reading
from skincal.gap.refit import refit
from skincal.gap.relocate import relocated
from skincal.gap.robust import times
from skincal.gap.silent import Silent, _none_missed, silent_taxels, with_silent_values, without_silent
from skincal.model.arrays import BoolArray, FloatArray

NONE = np.zeros(0, dtype=np.int64)


@cache
def one() -> Made:
    return made(seed=6)


@cache
def values() -> FloatArray:
    return one().truth.values(one().session)


@cache
def lately() -> tuple[int, int]:
    """The taxel and press of which no later press reaches that taxel, and the press does most."""
    press, found = one().session.press, list[tuple[float, int, int]]()
    for taxel in range(values().shape[1]):
        reached = np.unique(press[(values()[:, taxel] > 1.0) & (press >= 0)])
        if len(reached) > 3:
            last = int(reached[-1])
            found.append((float(values()[press == last, taxel].max()), taxel, last))
    _, taxel, last = max(found)
    return taxel, last


def rows_of(press: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.flatnonzero(one().session.press == press)


def seen_as(changed: FloatArray) -> Reading:
    counts = read(one().session, changed, np.random.default_rng(8), READOUT)
    return Reading.of(replace(one().session, counts=counts), SIGMA, READOUT)


def silent_in(rows: BoolArray, taxel: int) -> Reading:
    changed = values().copy()
    changed[rows, taxel] = 0.0
    return seen_as(changed)


def found_in(reading: Reading) -> list[Silent]:
    """Taxels that are silent, about a fit whose presses have followed their images, the dead taxel's too."""
    fitted = refit(one().start, one().session, reading, OPTIONS)
    return silent_taxels(fitted.hypothesis, one().session, reading, OPTIONS, NONE)


def test_a_taxel_that_dies_in_the_last_press_that_reaches_it_is_seen_to():
    taxel, press = lately()
    (found,) = found_in(silent_in(np.arange(len(one().session)) >= rows_of(press)[0], taxel))
    assert (found.dead.taxel, found.presses.tolist()) == (taxel, [press])
    first = rows_of(press)[0]
    assert times(one().session)[first - 1] <= found.dead.from_s <= times(one().session)[first + 2]
    assert found.dead.stuck_counts < 3 and found.share > 0.8


def test_in_the_middle_of_a_press_it_is_seen_when():
    taxel, press = lately()
    strongest = rows_of(press)[np.argmax(values()[rows_of(press), taxel])]
    (found,) = found_in(silent_in(np.arange(len(one().session)) >= strongest, taxel))
    assert found.dead.taxel == taxel
    assert found.dead.from_s == pytest.approx(times(one().session)[strongest], abs=1.5)


def test_a_taxel_that_answers_again_is_not_dead():
    taxel, _ = lately()
    press = one().session.press
    reached = np.unique(press[(values()[:, taxel] > 20.0) & (press >= 0)])
    assert found_in(silent_in(press == reached[-2], taxel)) == []


def glitched(press: int, kind: str) -> Reading:
    """A session of which one press is wrong, in a way that is no fault of a taxel."""
    changed, rows = values().copy(), rows_of(press)
    if kind == "other image":
        changed[rows] = changed[rows][:, ::-1]
    elif kind == "missed":
        changed[rows] = 0.0
    elif kind == "lost half-way":
        changed[rows[len(rows) // 2 :]] = 0.0
    else:
        changed[rows] *= float(kind)
    return seen_as(changed)


@pytest.mark.parametrize("kind", ["other image", "missed", "lost half-way", "0.3", "0.6"])
def test_a_press_that_is_wrong_as_a_whole_shows_no_dead_taxel(kind: str):
    for press in range(0, one().session.presses, 3):
        reading = glitched(press, kind)
        out = np.where(one().session.press == press, 0.0, 1.0)[:, None]
        fitted = refit(one().start, one().session, reading.trusting(out), OPTIONS)
        for doubted in (NONE, np.array([press])):
            assert silent_taxels(fitted.hypothesis, one().session, reading, OPTIONS, doubted) == [], press


def test_a_press_before_that_is_wrong_hides_no_dead_taxel():
    taxel, press = lately()
    reached = np.unique(one().session.press[(values()[:, taxel] > 20.0) & (one().session.press >= 0)])
    wrong = (one().session.press == reached[-3]) | (one().session.press == press)
    (found,) = found_in(silent_in(wrong, taxel))
    assert found.presses.tolist() == [press]


def test_a_taxel_that_never_answered_is_dead_from_the_beginning():
    (found,) = found_in(silent_in(np.ones(len(one().session), dtype=bool), lately()[0]))
    assert (found.dead.taxel, found.dead.from_s) == (lately()[0], 0.0) and len(found.presses) > 1
    assert not without_silent(one().reading, [found], one().session).seen[:, found.dead.taxel].any()


def test_one_press_does_not_show_that_a_taxel_never_answered():
    taxel = 8
    assert len(np.unique(one().session.press[(values()[:, taxel] > 4.0) & (one().session.press >= 0)])) == 1
    assert found_in(silent_in(np.ones(len(one().session), dtype=bool), taxel)) == []


def test_where_its_last_answer_is_missing_it_died_about_then():
    taxel, press = lately()
    strongest = rows_of(press)[np.argmax(values()[rows_of(press), taxel])]
    reading = silent_in(np.arange(len(one().session)) >= strongest, taxel)
    counts = reading.counts.copy()
    counts[strongest - 1, taxel] = np.nan
    (found,) = found_in(Reading.of(replace(one().session, counts=counts), SIGMA, READOUT))
    assert found.dead.from_s == pytest.approx(times(one().session)[strongest], abs=1.5)


def test_nothing_is_silent_where_nothing_is_wrong_or_all_is():
    assert found_in(one().reading) == []
    assert found_in(seen_as(0.0 * values())) == []


WIDE = replace(OPTIONS, position_sigma_m=1e-3)
"""Presses may lie where a dead taxel need not answer."""


def of_wide(seed: int, dies: tuple[int, int] | None, picks_up: float = 0.0) -> list[Silent]:
    """Silent taxels about a fit with wide places; one may die as one of the last presses that reach it begins, or ever.

    Args:
        seed: of the session.
        dies: which taxel, and with how many presses to go; 0: before the first.
        picks_up: see below.

    What it picks up then is a part of what it should read.
    """
    one = made(seed=seed)
    seen, press = one.truth.values(one.session), one.session.press
    if dies is not None:
        taxel, last = dies
        reached = np.unique(press[(seen[:, taxel] > 8.0) & (press >= 0)])
        seen[np.flatnonzero(press == reached[-last])[0] if last else 0 :, taxel] *= picks_up
    counts = read(one.session, seen, np.random.default_rng(8), READOUT)
    reading = Reading.of(replace(one.session, counts=counts), SIGMA, READOUT)
    fitted = refit(one.start, one.session, reading, WIDE).hypothesis
    fitted = refit(relocated(fitted, one.session, reading, WIDE), one.session, reading, WIDE).hypothesis
    return silent_taxels(fitted, one.session, reading, WIDE, NONE)


@pytest.mark.parametrize(
    ("seed", "taxel", "last"), [(6, 1, 2), (6, 3, 2), (7, 3, 2), (9, 3, 3), (11, 0, 2), (11, 1, 3)]
)
def test_presses_that_moved_away_from_a_dead_taxel_show_it_together(seed: int, taxel: int, last: int):
    (found,) = of_wide(seed, (taxel, last))
    assert found.dead.taxel == taxel and len(found.presses) > 1
    assert found.fall == pytest.approx(found.falls.sum()) and found.fall > 40


@pytest.mark.parametrize(
    ("seed", "taxel", "last"), [(6, 0, 2), (6, 3, 4), (7, 3, 2), (10, 1, 3), (11, 0, 3), (11, 3, 2)]
)
def test_what_a_dead_taxel_picks_up_from_its_neighbours_hides_it_not(seed: int, taxel: int, last: int):
    (found,) = of_wide(seed, (taxel, last), picks_up=0.05)
    assert found.dead.taxel == taxel and len(found.presses) > 1


@pytest.mark.parametrize(("seed", "last"), [(8, 4), (10, 3)])
def test_presses_that_light_nothing_else_count_where_others_show_it_too(seed: int, last: int):
    (found,) = of_wide(seed, (3, last), picks_up=0.05 if seed == 8 else 0.0)
    assert found.dead.taxel == 3 and len(found.presses) > 1


def test_presses_that_moved_far_from_a_dead_taxel_are_looked_for_where_they_were():
    (found,) = of_wide(11, (3, 3))
    assert found.dead.taxel == 3 and len(found.presses) > 1


@pytest.mark.parametrize("picks_up", [0.0, 0.05])
@pytest.mark.parametrize(("seed", "taxel"), [(6, 0), (6, 4), (7, 3), (9, 1), (11, 0)])
def test_a_taxel_that_never_answers_is_seen_by_the_presses_that_moved_away(
    seed: int, taxel: int, picks_up: float
):
    (found,) = of_wide(seed, (taxel, 0), picks_up)
    assert (found.dead.taxel, found.dead.from_s) == (taxel, 0.0) and len(found.presses) > 1
    time = times(made(seed=seed).session)
    assert found.between_s == (time[0], time[0])
    assert found.dead.stuck_counts < 2.0


@pytest.mark.parametrize("seed", range(6, 12))
def test_places_that_may_be_anywhere_make_no_live_taxel_silent(seed: int):
    assert of_wide(seed, None) == []


def test_a_taxel_that_answers_at_the_end_is_not_silent_though_presses_moved_away():
    one = made(seed=6)
    seen, press = one.truth.values(one.session), one.session.press
    reached = np.unique(press[(seen[:, 1] > 8.0) & (press >= 0)])
    seen[np.isin(press, reached[-3:-1]), 1] = 0.0
    counts = read(one.session, seen, np.random.default_rng(8), READOUT)
    reading = Reading.of(replace(one.session, counts=counts), SIGMA, READOUT)
    fitted = refit(one.start, one.session, reading, WIDE).hypothesis
    assert silent_taxels(fitted, one.session, reading, WIDE, NONE) == []


def brightest() -> tuple[int, list[int]]:
    """The taxel that most presses light before any other, and these presses."""
    press, most = one().session.press, dict[int, list[int]]()
    for row in range(one().session.presses):
        image = values()[press == row].max(axis=0)
        if image.max() > 20.0:
            most.setdefault(int(image.argmax()), []).append(row)
    return max(most.items(), key=lambda item: len(item[1]))


@pytest.mark.parametrize(
    ("missed", "fall", "scatter", "said"),
    [
        (0, 30.0, 1.0, True),
        (1, 30.0, 1.0, True),  # one of them may well have missed
        (2, 30.0, 1.0, False),  # so do presses over taxels that answer later
        (0, 10.0, 1.0, False),  # it need not lie far off
        (0, 30.0, 2.5, False),  # places are that far off in this session
    ],
)
def test_presses_that_show_nothing_have_not_all_missed(missed: int, fall: float, scatter: float, said: bool):
    session, (taxel, over) = one().session, brightest()
    dark, changed = over[-3:], values().copy()
    others = [
        row for row in range(session.presses) if row not in over and values()[session.press == row].max() > 20
    ]
    alive = [row for row in others if int(values()[session.press == row].max(axis=0).argmax()) != taxel]
    changed[np.isin(session.press, [*dark, *alive[:missed]])] = 0.0
    places = np.tile(
        [scatter * OPTIONS.position_sigma_m, scatter * OPTIONS.position_sigma_m, 0.0], (session.presses, 1)
    )
    here, falls = one().start.with_places(places / np.sqrt(2 / np.log(4))), np.full(session.presses, fall)
    given = (here, session, seen_as(changed), OPTIONS, values())
    assert _none_missed(dark, falls, *given) is said
    assert not _none_missed(dark[:2], falls + 50.0, *given)
    # Means of many frames have less noise than what clipping lifts them by; that is no answer.
    still = replace(given[2], frames=400.0 * given[2].frames)
    assert _none_missed(dark, falls, here, session, still, OPTIONS, values()) is said
    # What was not read has not missed.
    unread = np.isin(session.press, alive[missed : missed + 2])[:, None]
    gone = replace(given[2], trust=np.where(unread, 0.0, given[2].trust))
    assert _none_missed(dark, falls, here, session, gone, OPTIONS, values()) is said


def silence() -> tuple[Reading, Silent]:
    taxel, press = lately()
    reading = silent_in(np.arange(len(one().session)) >= rows_of(press)[0], taxel)
    (found,) = found_in(reading)
    return reading, found


def test_a_silent_taxel_is_not_believed_from_then_on_and_is_heard_again():
    reading, found = silence()
    less = without_silent(reading, [found], one().session)
    late = times(one().session) >= found.between_s[0]
    assert not less.seen[late, found.dead.taxel].any()
    kept = np.ones_like(reading.trust, dtype=bool)
    kept[late, found.dead.taxel] = False
    assert np.array_equal(less.trust[kept], reading.trust[kept])
    again = with_silent_values(less, [found], one().session)
    # But for the moment at which it fell silent.
    gone = times(one().session)[~np.isclose(again.trust, reading.trust).all(axis=1)]
    assert ((gone >= found.between_s[0]) & (gone < found.between_s[1])).all()
    # A press that was left out stays out.
    out = less.trusting(np.where(one().session.press == found.presses[0], 0.0, 1.0)[:, None])
    assert not with_silent_values(out, [found], one().session).seen[rows_of(int(found.presses[0]))].any()


def silence_throughout() -> tuple[Reading, Silent]:
    reading = silent_in(np.ones(len(one().session), dtype=bool), lately()[0])
    (found,) = found_in(reading)
    return reading, found


def named_in(*, clock: bool = True, throughout: bool = False) -> tuple[Choice, Choice]:
    """A choice of nothing, and the same with what is silent."""
    reading, found = silence_throughout() if throughout else silence()
    session = one().session if clock else without(one().session, time_s=None)
    less = without_silent(reading, [found], one().session)
    material = replace(one().material, session=session, reading=less)
    base = Model(refit(one().start, session, less, OPTIONS, learn=material.known))
    before = Choice(base, base, (), (), (0.0, 0.0), int(less.seen.sum()))
    null = Null(("fitted",) * 9, {"taxel_gain": np.full(9, 3.0)}, 1.0)
    return before, with_silent(before, [found], replace(material, reading=reading), null)


def test_it_is_named_with_what_it_reads_and_since_when():
    before, after = named_in()
    (named,) = after.named
    assert (named.name, named.p_value) == (NAME, 0.1) and named.share > 0.8
    _, found = silence()
    effect = after.after.hypothesis.effects[NAME]
    assert np.flatnonzero(effect["answer"] < 0.5).tolist() == [found.dead.taxel]
    assert effect["from_s"][found.dead.taxel] == found.dead.from_s
    assert after.excess == before.excess
    assert after.before.refit.objective > before.before.refit.objective + 200, (
        "a press that fit and choice may see"
    )
    assert after.after.refit.objective < after.before.refit.objective - 200


def test_where_presses_of_the_end_alone_show_it_it_stays_as_it_was_seen():
    reading, found = silence()
    known = one().material.known & ~np.isin(one().session.press, found.presses)
    less = without_silent(reading, [found], one().session)
    material = replace(one().material, reading=less, learn=known, score=np.zeros_like(known))
    base = Model(refit(one().start, one().session, less, OPTIONS, learn=known))
    before = Choice(base, base, (), (), (0.0, 0.0), int(less.seen.sum()))
    null = Null(("fitted",) * 9, {"taxel_gain": np.full(9, 3.0)}, 1.0)
    after = with_silent(before, [found], replace(material, reading=reading), null)
    own = after.after.hypothesis.effects[NAME]
    assert after.after.coords == () and own["answer"][found.dead.taxel] == 0.0
    assert own["stuck_counts"][found.dead.taxel] == pytest.approx(found.dead.stuck_counts)


def test_without_a_clock_nothing_can_be_named_that_began_later():
    before, after = named_in(clock=False)
    assert after is before


def test_without_a_clock_a_taxel_that_never_answered_is_named():
    _, after = named_in(clock=False, throughout=True)
    assert [n.name for n in after.named] == [NAME]
    effect = after.after.hypothesis.effects[NAME]
    assert np.flatnonzero(effect["answer"] < 0.5).tolist() == [lately()[0]]


def base_of(reading: Reading, **parts: object) -> tuple[Base, Model]:
    """A base of a session whose model is the truth."""
    material = replace(one().material, reading=reading)
    model = Model(refit(one().truth, one().session, reading, OPTIONS, learn=material.known))
    return replace(Base(model, material, NONE, (), ()), **parts), model


def test_what_another_model_explains_was_not_silent():
    _, found = silence()
    less = without_silent(one().reading, [found], one().session)
    base, model = base_of(less, silent=(found,))
    again = heard_again(base, model)
    assert again.silent == ()
    gone = times(one().session)[~np.isclose(again.material.reading.trust, one().reading.trust).all(axis=1)]
    assert len(gone) <= 1


def test_a_press_that_was_left_out_is_heard_again_for_its_silent_taxel():
    reading, found = silence()
    out = np.where(np.isin(one().session.press, found.presses), 0.0, 1.0)[:, None]
    base, model = base_of(reading.trusting(out), glitches=found.presses)
    again = heard_again(base, model)
    assert [s.dead.taxel for s in again.silent] == [found.dead.taxel] and not len(again.glitches)
    assert again.material.reading.seen[rows_of(int(found.presses[0]))].any()


def test_each_of_several_silent_taxels_is_heard_again_by_itself(monkeypatch: pytest.MonkeyPatch):
    """With two believed that are silent, presses lie elsewhere, and neither may be seen any more."""
    _, found = silence()
    other = (found.dead.taxel + 1) % values().shape[1]
    both = (found, replace(found, dead=replace(found.dead, taxel=other)))
    late = times(one().session) >= found.between_s[1]
    told: list[tuple[bool, bool]] = []

    def look(here: Hypothesis, session: object, reading: Reading, *rest: object) -> list[Silent]:
        believed = [bool(reading.seen[late, s.dead.taxel].any()) for s in both]
        told.append((believed[0], believed[1]))
        return [s for s, heard in zip(both, believed, strict=True) if heard] if sum(believed) == 1 else []

    monkeypatch.setattr("skincal.diagnose.second_look.silent_taxels", look)
    base, model = base_of(without_silent(one().reading, both, one().session), silent=both)
    again = heard_again(base, model)
    assert sorted(told) == [(False, False), (False, True), (True, False), (True, True)]
    assert {s.dead.taxel for s in again.silent} == {s.dead.taxel for s in both}


def test_without_doubt_nothing_is_heard_again():
    base, model = base_of(one().reading)
    assert heard_again(base, model) is base


@pytest.mark.parametrize("last", [2, 3])
def test_a_taxel_that_was_believed_is_seen_to_be_silent_beside_what_was_named(last: int):
    one = made({"ghosting": {"array_leak": 0.08}}, seed=6)
    press, values = one.session.press, one.truth.values(one.session)
    own = without_its_effects(one).values(one.session)
    reached = np.unique(press[(own[:, 3] > 20.0) & (press >= 0)])
    dead = np.arange(len(one.session)) >= np.flatnonzero(press == reached[-last])[0]
    values[dead, 3] = 0.0
    counts = read(one.session, values, np.random.default_rng(8), READOUT)
    spoilt = replace(one, reading=Reading.of(replace(one.session, counts=counts), SIGMA, READOUT))
    after = Model(refit(one.start, one.session, spoilt.reading, OPTIONS, fixed=one.truth.effects))
    base = Base(Model(refit(one.start, one.session, spoilt.reading, OPTIONS)), spoilt.material, NONE, (), ())
    (found,) = silent_beside(base, after)
    assert found.dead.taxel == 3 and set(reached[-last:]) <= set(found.presses)
    assert silent_beside(replace(base, material=one.material), after) == []
    # What presses in doubt show alone is looked at when those are.
    assert silent_beside(replace(base, glitches=found.presses), after) == []
    assert silent_beside(replace(base, silent=(found,)), after) == []


def without_its_effects(one: Made) -> Hypothesis:
    """The truth of a session but for what is hidden in it."""
    return replace(one.truth, effects={})
