"""What was hidden is named, one effect or two, nothing where nothing is, and only what earns its place."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any, cast

import numpy as np
import pytest
from gap.made_sessions import CASES, OPTIONS, Case, Effects, based, case, made, scene_of

import skincal.gap.contest as contest_module
from skincal.effects import EFFECTS
from skincal.gap.candidates import Found, best_of
from skincal.gap.choice import Choice, Named, Round
from skincal.gap.choice_options import ChoiceOptions
from skincal.gap.choose import _searched as searched
from skincal.gap.choose import against_rivals, choose, dropped, outdone
from skincal.gap.contest import Contest, Needed, further
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.library import Library
from skincal.gap.models import Material, Model, begun_again, excess_of, extended, without
from skincal.gap.null import Null, simulate_null
from skincal.gap.refit import refit
from skincal.gap.related import KINDS, likeness, of_one_kind
from skincal.gap.rivals import beside_all, rivals
from skincal.gap.simpler import fewest, simplest

NAMES = ("hysteresis", "crosstalk", "saturation", "taxel_gain", "contact_offset", "force_bias", "gain_drift")
TWO: Effects = {**CASES["hysteresis"], "crosstalk": {"leak": 0.02}}


@cache
def library_and_null(name: str) -> tuple[Library, Null]:
    """What the effects do about a case, and what they score by chance."""
    return material_of(case(name))


def material_of(of: Case) -> tuple[Library, Null]:
    library = Library.of(of.scene, NAMES)
    errors = {"fitted": np.zeros_like(of.scene.zero)}
    rng = np.random.default_rng(0)
    return library, simulate_null(of.scene, of.made.material, library, errors, 200, rng)


def chosen(of: Case, given: tuple[Library, Null], options: ChoiceOptions | None = None) -> Choice:
    library, null = given
    return choose(of.model, of.made.material, library, null.p_value, null.mean_square, options)


@cache
def choice_of(name: str) -> Choice:
    return chosen(case(name), library_and_null(name))


def named(choice: Choice) -> tuple[str, ...]:
    return tuple(one.name for one in choice.named)


@pytest.mark.parametrize(
    "name", ["hysteresis", "crosstalk", pytest.param("taxel_gain", marks=pytest.mark.slow)]
)
def test_one_hidden_effect_is_named_and_no_other(name: str):
    choice = choice_of(name)
    assert named(choice) == (name,)
    (one,) = choice.named
    assert one.consistent_with[0] == name and one.p_value <= 0.01 and one.share > 0.7
    assert choice.explained > 0.8
    assert choice.before.names == () and choice.after.names == (name,)
    for key, value in CASES[name][name].items():
        found = choice.after.hypothesis.effects[name][key]
        assert np.abs(found - value).max() < 0.3 * np.abs(value).max(), key


@pytest.mark.parametrize(
    ("halfway", "chance", "expected"), [(0.5, 0.0, ("hysteresis",)), (0.0, 0.0, ()), (0.5, 0.02, ())]
)
def test_where_the_best_explain_little_all_others_that_score_are_fitted(
    monkeypatch: pytest.MonkeyPatch, halfway: float, chance: float, expected: tuple[str, ...]
):
    """A search that is misled: what explains nearly all comes far behind what explains next to nothing."""
    of = case("hysteresis")
    library, null = library_and_null("hysteresis")

    def misled(*given: Any, **more: Any) -> list[Found]:
        found = {f.effect: f for f in searched(*given, **more)}
        right = found.pop("hysteresis", None)
        wrong = min(found.values(), key=lambda f: f.scored)
        return [replace(wrong, scored=1e6), *([] if right is None else [replace(right, scored=1e4)])]

    monkeypatch.setattr("skincal.gap.choose._searched", misled)
    options = ChoiceOptions(halfway=halfway, most=1)

    def p_value(name: str, scored: float) -> float:
        return chance if name == "hysteresis" else 0.001

    choice = choose(of.model, of.made.material, library, p_value, null.mean_square, options)
    assert named(choice) == expected
    assert [one.p_value for one in choice.named] == [0.0] * len(expected)


@pytest.mark.parametrize(
    ("sure", "hidden", "expected"),
    [(4.0, True, ("hysteresis",)), (1e9, True, ()), (4.0, False, ())],
)
def test_what_a_search_finds_far_too_large_is_scored_by_a_full_fit(
    monkeypatch: pytest.MonkeyPatch, sure: float, hidden: bool, expected: tuple[str, ...]
):
    """A search that no effect comes out of with a score: the right one is named, where it is there, and no other."""
    of = case("hysteresis")
    library, null = library_and_null("hysteresis")

    def misled(*given: Any, **more: Any) -> list[Found]:
        found = [f for f in searched(*given, **more) if hidden or f.effect != "hysteresis"]
        return [replace(f, scored=-float(k)) for k, f in enumerate(found)]

    monkeypatch.setattr("skincal.gap.choose._searched", misled)
    options = ChoiceOptions(sure=sure, most=1)
    choice = choose(of.model, of.made.material, library, null.p_value, null.mean_square, options)
    assert named(choice) == expected
    assert all(one.p_value <= 0.01 and one.share > 0.7 for one in choice.named)
    assert hidden or not choice.rounds[0].fits


@pytest.mark.parametrize(("holds", "expected"), [(0.1, ("hysteresis",)), (2.0, ())])
def test_where_the_best_explain_little_every_effect_may_be_it(
    monkeypatch: pytest.MonkeyPatch, holds: float, expected: tuple[str, ...]
):
    """A search that leaves the right one out at first, and has it as the last of all then."""
    of = case("hysteresis")
    library, null = library_and_null("hysteresis")

    def misled(*given: Any, every: bool = False) -> list[Found]:
        found = searched(*given, every=every)
        wrong = [replace(f, scored=-1e3) for f in found if f.effect != "hysteresis"]
        right = [replace(f, scored=-1e4, learned=-1e4) for f in found if f.effect == "hysteresis"]
        return [*wrong, *(right if every else [])]

    monkeypatch.setattr("skincal.gap.choose._searched", misled)
    options = ChoiceOptions(most=1, contenders=2, holds=holds)
    choice = choose(of.model, of.made.material, library, lambda *_: 0.001, null.mean_square, options)
    assert named(choice) == expected


@pytest.mark.parametrize(
    ("holds", "explained"),
    [
        (True, 0.0),
        (False, 0.0),
        (False, 0.99),  # the first does not explain enough: all are fitted beside it
    ],
)
def test_a_later_effect_that_is_searched_in_vain_is_named_if_it_holds_for_others_or_a_fit_to_all_needs_it(
    monkeypatch: pytest.MonkeyPatch, holds: bool, explained: float
):
    of, (library, null) = two()

    def misled(*given: Any, **more: Any) -> list[Found]:
        """As the search is in the first round; later what explains nearly all comes far behind."""
        found = searched(*given, **more)
        left = [f for f in found if f.effect in TWO]
        wrong = min((f for f in found if f.effect not in TWO), key=lambda f: f.scored)
        if len(left) > 1:
            return found
        return [replace(wrong, scored=1e6), *(replace(f, scored=-1e4) for f in left)]

    monkeypatch.setattr("skincal.gap.choose._searched", misled)
    if not holds:
        monkeypatch.setattr("skincal.gap.contest.Contest._of_others", lambda *_: 1.0)
    options = ChoiceOptions(explained=explained)
    choice = choose(of.model, of.made.material, library, lambda *_: 0.001, null.mean_square, options)
    first, later = choice.rounds[:2]
    assert first.taken in TWO
    if holds or explained:
        assert set(named(choice)) == set(TWO)
        assert later.found[0].effect != later.taken and next(iter(later.fits)) != later.taken
    else:
        assert named(choice) == (first.taken,) and later.taken is None and not set(later.fits) & set(TWO)


def test_what_lives_in_the_positions_is_named_too():
    choice = choice_of("contact_offset")
    assert "contact_offset" in named(choice)[:1]


@cache
def two() -> tuple[Case, tuple[Library, Null]]:
    one = made(TWO)
    model = based(one)
    of = Case(one, model, scene_of(one, model))
    return of, material_of(of)


def test_two_hidden_effects_are_named():
    of, given = two()
    one, choice = of.made, chosen(of, given)
    assert set(named(choice)) == set(TWO)
    assert len(choice.rounds) >= 2 and choice.explained > 0.8
    found = choice.after.hypothesis.effects
    assert found["hysteresis"]["height"] == pytest.approx(0.3, abs=0.1)
    assert found["crosstalk"]["leak"] == pytest.approx(0.02, rel=0.3)
    again = without(choice.after, "crosstalk", one.material)
    assert again.names == ("hysteresis",)
    assert again.refit.objective > choice.after.refit.objective + 100
    model, kept = dropped(choice.after, choice.named, one.material, dict.fromkeys(TWO, 100.0), {})
    assert model is choice.after and kept == list(choice.named)


@pytest.mark.parametrize(("most", "again"), [(1, 1), (2, 1)])
def test_a_fit_begins_anew_where_much_is_left(most: int, again: int, monkeypatch: pytest.MonkeyPatch):
    (of, (library, null)), begun = two(), list[tuple[Model, Model]]()

    def counted(model: Model, material: Material, fresh: Hypothesis) -> Model:
        assert fresh is start
        begun.append((model, begun_again(model, material, fresh)))
        return begun[-1][1]

    start, options = of.made.start, ChoiceOptions(most=most)
    monkeypatch.setattr("skincal.gap.choose.begun_again", counted)
    choice = choose(of.model, of.made.material, library, null.p_value, null.mean_square, options, fresh=start)
    # Once hysteresis is named crosstalk is left; with both, nothing is.
    assert len(choice.named) == most and len(begun) == again
    assert begun[0][1].names == begun[0][0].names == (choice.named[0].name,)
    assert choice.after.refit.objective <= min(model.refit.objective for model in begun[0])
    plain = choose(of.model, of.made.material, library, null.p_value, null.mean_square, options)
    assert len(begun) == again
    assert choice.after.refit.objective < plain.after.refit.objective + 1.0


@pytest.mark.parametrize(("most_of_rest", "count"), [(0.6, 2), (2.0, 1)])
def test_a_little_second_effect_is_named_if_it_explains_most_of_what_is_left(most_of_rest: float, count: int):
    options = ChoiceOptions(of_all=0.5, clear=1e6, enough=0.0, most_of_rest=most_of_rest)
    choice = chosen(*two(), options)
    share = max(choice.rounds[1].falls.values()) / choice.rounds[1].excess
    assert 0.6 < share < 1.1 and max(choice.rounds[1].falls.values()) < 0.5 * choice.rounds[0].excess
    assert len(choice.named) == count


def test_presses_are_not_looked_for_once_more_with_an_effect_with_which_they_were(
    monkeypatch: pytest.MonkeyPatch,
):
    of, (library, null) = two()
    heard: list[str] = []

    def all_looked_again(contest: Contest, found: Any, fits: Any, every: Any, needed: Needed) -> Any:
        fits, found, _ = further(contest, found, fits, every, needed)
        return fits, found, frozenset(fits)

    monkeypatch.setattr("skincal.gap.choose.further", all_looked_again)
    monkeypatch.setattr("skincal.gap.choose.begun_again", lambda *_: pytest.fail("begun again"))
    args = (of.model, of.made.material, library, null.p_value, null.mean_square, ChoiceOptions(most=1))
    choice = choose(*args, heard=heard.append, fresh=of.made.start)
    assert len(choice.named) == 1 and not any("presses again" in h for h in heard)


def test_an_effect_that_the_others_do_without_is_dropped():
    of, choice = case("crosstalk"), choice_of("crosstalk")
    first = best_of(of.scene, "force_bias", *(of.scene.part(r) for r in parts(of)))
    assert first is not None
    alone = extended(of.model, first, of.made.material)
    both = extended(
        alone, next(f for f in choice.rounds[0].found if f.effect == "crosstalk"), of.made.material
    )
    assert both.names == ("force_bias", "crosstalk")
    named = [Named("force_bias", ("force_bias",), 0.5, 0.01), choice.named[0]]
    least = dict.fromkeys(both.names, 0.05 * choice.excess[0])
    model, kept = dropped(both, named, of.made.material, least, {})
    assert [k.name for k in kept] == ["crosstalk"] and model.names == ("crosstalk",)
    assert model.refit.objective == pytest.approx(choice.after.refit.objective, abs=15)
    # The last one as well, but never the only one.
    model, kept = dropped(both, named[::-1], of.made.material, least, {})
    assert [k.name for k in kept] == ["crosstalk"]
    assert dropped(alone, named[:1], of.made.material, {"force_bias": 1e9}, {}) == (alone, named[:1])


def test_an_effect_that_a_later_one_outdid_is_dropped_where_the_fit_without_it_begins_anew(
    monkeypatch: pytest.MonkeyPatch,
):
    of, choice = case("crosstalk"), choice_of("crosstalk")
    material, alone = of.made.material, choice.after
    both = with_one_more(alone, "force_bias", of)
    lost = replace(alone, refit=replace(alone.refit, objective=alone.refit.objective + 1e4))
    excess = {id(both): 0.0, id(lost): 1e4, id(alone): 10.0}
    monkeypatch.setattr("skincal.gap.choose.excess_of", lambda model, *_: excess[id(model)])
    monkeypatch.setattr("skincal.gap.choose.without", lambda *_: lost)
    monkeypatch.setattr("skincal.gap.choose.found_again", lambda model, _: model)
    monkeypatch.setattr("skincal.gap.choose.begun_again", lambda model, _, fresh: fresh)
    named = [Named("force_bias", ("force_bias",), 0.3, 0.01), Named("crosstalk", ("crosstalk",), 0.9, 0.01)]
    least = dict.fromkeys(both.names, 100.0)
    assert dropped(both, named, material, least, {}) == (both, named)
    anew: Any = {"force_bias": alone}
    model, kept = dropped(both, named, material, least, anew)
    assert model is alone and kept == named[1:]


def test_what_a_later_effect_outdid_is_told():
    named = [Named(n, (n,), 0.5, 0.01) for n in ("first", "second", "third")]
    falls = {"first": 5.0, "second": 9.0, "third": 2.0}
    rounds = [Round((), 1.0, {n: fall}, taken=n) for n, fall in falls.items()]
    assert outdone(named, [*rounds, Round((), 1.0, {"fourth": 99.0})]) == ["first"]
    assert outdone(named[1:], rounds) == []


def with_one_more(model: Model, name: str, of: Case) -> Model:
    """A model with what a search about the base model finds of an effect."""
    found = best_of(of.scene, name, *(of.scene.part(r) for r in parts(of)))
    assert found is not None
    return extended(model, found, of.made.material)


def test_beside_all_others_the_right_one_takes_the_place_of_a_rival():
    of, given = two()
    material, options = of.made.material, ChoiceOptions()
    alone = {n: with_one_more(of.model, n, of) for n in ("saturation", "hysteresis")}
    wrong = with_one_more(alone["saturation"], "crosstalk", of)
    model, names = beside_all(
        wrong, "saturation", {"hysteresis": alone["hysteresis"]}, material, options, 10**4
    )
    assert names == ("hysteresis",) and set(model.names) == set(TWO)
    right = chosen(of, given)
    assert model.refit.objective == pytest.approx(right.after.refit.objective, abs=30)
    # And stays where it is.
    again, names = beside_all(
        model, "hysteresis", {"saturation": alone["saturation"]}, material, options, 10**4
    )
    assert names == ("hysteresis",) and again is model
    # Of what cannot be told apart the one that was named stays, and the other is told.
    close = ChoiceOptions(alike=0.0, half=0.0, weakest=10.0)
    stays, names = beside_all(
        wrong, "saturation", {"hysteresis": alone["hysteresis"]}, material, close, 10**4
    )
    assert names == ("saturation", "hysteresis") and stays is wrong


def test_what_came_near_when_an_effect_was_named_is_tried_beside_all_others():
    of, given = two()
    choice = chosen(of, given)
    first, second = choice.named
    values = int(of.made.material.reading.seen.sum())
    stand_in = next(n for n in ("saturation", "gain_drift") if n not in choice.rounds[0].falls)
    own = replace(
        choice.rounds[0],
        falls={**choice.rounds[0].falls, stand_in: choice.rounds[0].falls[first.name]},
        fits={**choice.rounds[0].fits, stand_in: with_one_more(of.model, stand_in, of)},
    )
    rounds = (own, *choice.rounds[1:])
    assert stand_in in rivals(own.falls, first.name, choice.after, ChoiceOptions())
    model, kept = against_rivals(
        choice.after, choice.named, rounds, of.made.material, ChoiceOptions(), values
    )
    assert model is choice.after and [k.name for k in kept] == [first.name, second.name]
    # The last one was chosen beside all the others already; one alone has nobody beside it.
    model, kept = against_rivals(
        choice.after, choice.named[:1], rounds, of.made.material, ChoiceOptions(), values
    )
    assert model is choice.after and kept == [first]


def parts(of: Case) -> tuple[np.ndarray, np.ndarray]:
    """What parameters are found on, and what chooses."""
    return of.made.material.learn, of.made.material.score


def test_nothing_is_named_where_nothing_is_hidden():
    choice = choice_of("none")
    assert choice.named == () and choice.after is choice.before


@pytest.mark.slow
def test_nothing_is_named_in_many_sessions_without_effects():
    count = 0
    for seed in range(20, 32):
        one = made(seed=seed)
        model = based(one)
        of = Case(one, model, scene_of(one, model))
        count += bool(chosen(of, library_and_null("none")).named)
    assert count <= 1


def test_not_more_than_allowed_and_nothing_at_a_level_that_nothing_reaches():
    of, given = case("hysteresis"), library_and_null("hysteresis")
    assert named(chosen(of, given, ChoiceOptions(most=0))) == ()
    never = ChoiceOptions(significant=0.0)
    none = chosen(of, given, never)
    assert none.named == () and len(none.rounds) == 1
    assert chosen(of, given, ChoiceOptions(share_first=1.01)).named == ()


def test_an_effect_that_a_calibration_has_already_is_not_named_again():
    one = made(CASES["hysteresis"])
    fixed = one.truth.effects
    found = refit(one.start, one.session, one.reading, OPTIONS, learn=one.material.known, fixed=fixed)
    model = Model(found, (), fixed)
    of = Case(one, model, scene_of(one, model))
    choice = chosen(of, library_and_null("none"))
    assert choice.named == () and choice.after.names == ("hysteresis",)
    # With something else missing beside it, that is named and the known one stays as it is.
    both = made({**fixed, "crosstalk": {"leak": 0.05}})
    found = refit(both.start, both.session, both.reading, OPTIONS, learn=both.material.known, fixed=fixed)
    model = Model(found, (), fixed)
    choice = chosen(Case(both, model, scene_of(both, model)), library_and_null("none"))
    assert named(choice) == ("crosstalk",)
    assert choice.after.hypothesis.effects["hysteresis"]["height"] == 0.3


def test_rounds_tell_what_was_tried():
    choice = choice_of("hysteresis")
    first = choice.rounds[0]
    scores = [f.scored for f in first.found]
    assert scores == sorted(scores, reverse=True)
    assert first.excess == choice.excess[0]
    assert first.falls["hysteresis"] == max(first.falls.values())
    fallen = choice.excess[0] - choice.excess[1]
    # Looking for presses again may only have gained, and here has little to gain.
    assert choice.after.refit.objective <= first.fits["hysteresis"].refit.objective
    assert first.falls["hysteresis"] == pytest.approx(fallen, rel=1e-3)
    assert choice.explained == pytest.approx(1 - max(choice.excess[1], 0) / choice.excess[0])


def test_excess_is_what_no_null_session_has():
    of = case("none")
    _, null = library_and_null("none")
    many = 9 * of.made.material.known.sum()
    left = excess_of(of.model, of.made.material, null.mean_square)
    assert abs(left) < 6 * np.sqrt(2 * many)
    hidden = case("crosstalk")
    assert excess_of(hidden.model, hidden.made.material, 1.0) > 2000


class Told(Contest):
    """A contest of which it is known what full fits explain; they are told in order."""

    def __init__(self, options: ChoiceOptions, falls: dict[str, float], left: float = 1000.0) -> None:
        of = case("hysteresis")
        super().__init__(of.model, of.made.material, lambda *_: 0.5, 1.0, options, left)
        object.__setattr__(self, "falls", falls)
        object.__setattr__(self, "asked", [])

    def fits(self, found: Any) -> dict[str, Any]:
        self.asked.extend(f.effect for f in found)
        return {f.effect: f.effect for f in found}

    def fall(self, model: Any) -> float:
        return self.falls[model]

    def holding(self, found: Any, share: float, *, every: bool = False) -> list[Found]:
        return []


@pytest.mark.parametrize(
    ("beside", "lacking", "first", "all_tried"),
    [
        (1, 0.5, 300.0, True),  # what was fitted explains three tenths, and half is asked for
        (1, 0.1, 300.0, True),  # enough together with what is named, too little beside it
        (1, 0.5, 600.0, False),
        (1, -0.2, 100.0, False),  # what is named is enough
        (2, 0.5, 100.0, False),
        (0, 0.75, 600.0, False),
    ],
)
def test_where_two_effects_do_not_explain_enough_every_other_is_fitted_beside_the_first(
    beside: int, lacking: float, first: float, all_tried: bool
):
    starts = case("hysteresis").scene.bench.starts
    names = ("crosstalk", "taxel_gain", "contact_offset")
    one, gain, places = (Found(starts(n)[0], np.zeros(1), 0.0, -s) for s, n in enumerate(names))
    contest = Told(ChoiceOptions(), {"crosstalk": first, "taxel_gain": 700.0})
    object.__setattr__(contest, "looked_again", lambda fits, _: {})
    heard: list[str] = []
    needed = Needed(beside, 1000.0, lacking, heard.append)
    fits: Any = contest.fits([one])
    fits, found, _ = further(contest, [one], fits, lambda: [one, gain, places], needed)
    # Errors of places are told by places.
    assert contest.asked == ["crosstalk", "taxel_gain"][: 1 + all_tried]
    assert list(fits) == contest.asked == [f.effect for f in found]
    assert [h.split()[0] for h in heard] == ["fitting", "presses"] * all_tried


@pytest.mark.parametrize(
    ("beside", "falls", "again"),
    [
        (0, {"a": 500.0, "b": 480.0, "c": 260.0, "d": 200.0}, ["a", "b", "c"]),
        (0, {"a": 500.0, "b": 240.0}, []),  # less than half of the best
        (0, {"a": 300.0, "b": 240.0}, []),  # too little to be named
        (0, {"a": 760.0, "b": 740.0}, []),  # the best explains enough as it is
        (0, {"a": 501.0, "b": 502.0, "c": 503.0, "d": 504.0}, ["d", "c", "b"]),
        # Beside the first effect all that explain a tenth, where much would be left.
        (1, {"a": 500.0, "b": 480.0, "c": 110.0, "d": 90.0}, ["a", "b", "c"]),
        (1, {"a": 500.0}, ["a"]),
        (1, {"a": 760.0, "b": 740.0}, []),
        (2, {"a": 500.0, "b": 480.0}, []),
    ],
)
def test_which_of_those_that_explain_about_as_much_goes_first_is_seen_once_presses_were_looked_for_again(
    beside: int, falls: dict[str, float], again: list[str]
):
    after = {f"{n} again": 650.0 for n in falls}
    contest, heard, fresh = Told(ChoiceOptions(), {**falls, **after}), list[str](), object()

    def looked(fits: dict[str, Any], start: Any) -> dict[str, Any]:
        assert start is fresh
        return {n: f"{n} again" for n in fits}

    object.__setattr__(contest, "looked_again", looked)
    needed: Any = Needed(beside, 100.0, -1.0, heard.append, cast("Any", fresh))
    fits: Any = {n: n for n in falls}
    fits, _, of_them = further(contest, [], fits, list, needed)
    assert of_them == set(again)
    assert fits == {n: f"{n} again" if n in again else n for n in falls}
    told = f"presses again, with each of {', '.join(again)}"
    assert [h for h in heard if h.startswith("presses again")] == [told] * bool(again)


def test_a_fit_that_explains_less_once_presses_were_looked_for_again_stays_as_it_was():
    falls = {"a": 500.0, "b": 480.0, "a again": 470.0, "b again": 600.0}
    contest, heard = Told(ChoiceOptions(), falls), list[str]()
    object.__setattr__(contest, "looked_again", lambda fits, _: {n: f"{n} again" for n in fits})
    fits: Any = {"a": "a", "b": "b"}
    fits, *_ = further(contest, [], fits, list, Needed(0, 100.0, -1.0, heard.append))
    assert fits == {"a": "a", "b": "b again"}


@pytest.mark.parametrize(("least", "all_tried"), [(90.0, True), (110.0, False)])
def test_where_much_would_be_left_beside_two_effects_every_other_is_fitted(least: float, all_tried: bool):
    starts = case("hysteresis").scene.bench.starts
    one, other = (Found(starts(n)[0], np.zeros(1), 0.0, 0.0) for n in ("crosstalk", "cover"))
    contest = Told(ChoiceOptions(), {"crosstalk": 600.0, "cover": 50.0})
    object.__setattr__(contest, "looked_again", lambda fits, _: {})
    heard: list[str] = []
    fits: Any = contest.fits([one])
    fits, *_ = further(contest, [one], fits, lambda: [one, other], Needed(1, least, -1.0, heard.append))
    # Of 1000, 400 would be left: four times the weakest effect, or less.
    assert list(fits) == ["crosstalk", "cover"][: 1 + all_tried]


@dataclass(frozen=True, eq=False)
class Beginning:
    """What stands for a full fit: where it comes from, and its objective."""

    name: str
    objective: float

    @property
    def refit(self) -> Beginning:
        return self


@pytest.mark.parametrize(
    ("begun", "again"),
    [
        ({"a": 60.0, "b": 90.0}, {"a": "a begun, found", "b": "b, found"}),  # the better of two beginnings
        ({"a": 20.0, "b": 90.0}, {"a": "a begun, found"}),  # b explains less than half of what a does then
        (None, {"a": "a, found", "b": "b, found"}),
    ],
)
def test_presses_are_looked_for_again_with_what_explains_most_from_the_better_of_two_beginnings(
    begun: dict[str, float] | None, again: dict[str, str], monkeypatch: pytest.MonkeyPatch
):
    of, start = case("hysteresis"), cast("Any", object())

    def anew(model: Beginning, material: Material, fresh: Any) -> Beginning:
        assert fresh is start and begun is not None and material.options.mapper is map
        return Beginning(f"{model.name} begun", begun[model.name])

    def found(model: Beginning, _: Material) -> Beginning:
        return Beginning(f"{model.name}, found", model.objective - 1)

    monkeypatch.setattr(contest_module, "found_again", found)
    monkeypatch.setattr(contest_module, "begun_again", anew)
    contest = Contest(of.model, of.made.material, lambda *_: 0.5, 1.0, ChoiceOptions(), 100.0)
    object.__setattr__(contest, "fall", lambda model: 100.0 - model.objective)
    fits: Any = {"a": Beginning("a", 70.0), "b": Beginning("b", 65.0)}
    looked = contest.looked_again(fits, start if begun else None)
    assert {n: m.name for n, m in cast("dict[str, Beginning]", looked).items()} == again


def test_full_fits_of_the_round_before_are_not_made_again(monkeypatch: pytest.MonkeyPatch):
    of = case("hysteresis")
    made_again: list[str] = []

    def extended_to(model: Model, found: Found, _: Material) -> Model:
        made_again.append(found.effect)
        return model

    monkeypatch.setattr(contest_module, "extended", extended_to)
    found = [Found(of.scene.bench.starts(n)[0], np.zeros(1), 0.0, 0.0) for n in ("crosstalk", "saturation")]
    known = replace(of.model)
    contest = Contest(
        of.model, of.made.material, lambda *_: 0.5, 1.0, ChoiceOptions(), 9.0, {"crosstalk": known}
    )
    fits = contest.fits(found)
    assert fits["crosstalk"] is known and made_again == ["saturation"]
    assert list(fits) == ["crosstalk", "saturation"]


def test_progress_is_told():
    heard: list[str] = []
    of = case("hysteresis")
    library, null = library_and_null("hysteresis")
    options = ChoiceOptions(most=1)
    choose(of.model, of.made.material, library, null.p_value, null.mean_square, options, heard=heard.append)
    assert heard[0].startswith("round 1") and "hysteresis" in heard[1]


def test_what_a_later_effect_must_explain_grows_with_the_first_but_not_without_end():
    options = ChoiceOptions(of_all=0.06, clear=0.4, weakest=0.1)
    assert options.later(0.06, 1000.0, 20_000) == pytest.approx(60.0)
    assert options.later(0.06, 1e9, 20_000) == pytest.approx(0.16 * 20_000)
    assert options.least(20_000) == pytest.approx(200.0)


def test_beside_a_law_that_explains_much_an_effect_must_be_stronger():
    options = ChoiceOptions(weakest=0.1, beside_law=0.25, share_of_law=0.5)
    for law, least in ((0.0, 0.1), (0.1, 0.1), (0.4, 0.2), (2.0, 0.25)):
        assert options.least(10_000, law) == pytest.approx(10_000 * least**2)


def test_of_few_values_the_weakest_effect_stands_out_as_of_many():
    options = ChoiceOptions(weakest=0.1, of_few=100.0)
    for values, least in ((0, 100.0), (1400, 100.0), (10_000, 100.0), (20_000, 200.0)):
        assert options.least(values) == pytest.approx(least)
    # Whatever a law explains.
    assert options.least(1400, 1.0) == pytest.approx(100.0)
    assert options.least(2000, 1.0) == pytest.approx(2000 * options.beside_law**2) == pytest.approx(125.0)


def test_a_difference_too_small_to_be_named_does_not_choose_between_names():
    options = ChoiceOptions(alike=0.9, half=0.5, weakest=0.1)
    # The weakest effect lowers the squared residual of 10 000 values by 100.
    for fall, needed in ((5000.0, 4500.0), (500.0, 400.0), (150.0, 75.0)):
        assert options.about(fall, 10_000) == pytest.approx(needed)


def test_few_numbers_go_before_many_unless_these_leave_far_less():
    options = ChoiceOptions(broad=0.9, no_worse=1.5, weakest=0.1)
    # Of 1000 the broad one leaves 200: 50 more may be left.  Of 10 000 values the weakest effect explains 100.
    for fall, needed in ((800.0, 720.0), (960.0, 864.0), (940.0, 850.0)):
        assert options.enough_of(fall, 1000.0, 10_000) == pytest.approx(needed)
    # Where it leaves next to nothing of much, it has been seen that the numbers differ.
    assert options.enough_of(9990.0, 10_000.0, 10_000) == pytest.approx(9850.0)


def test_of_effects_that_explain_as_much_the_one_with_few_numbers_goes_first():
    of = case("hysteresis")
    starts = {name: of.scene.bench.starts(name)[0] for name in ("hysteresis", "taxel_offset", "saturation")}
    fits = {name: replace(of.model, coords=start.coords) for name, start in starts.items()}
    falls = {"hysteresis": 95.0, "taxel_offset": 100.0, "saturation": 97.0}
    assert simplest(["hysteresis", "taxel_offset"], falls, fits) == "hysteresis"
    assert simplest(["hysteresis", "saturation", "taxel_offset"], falls, fits) == "saturation"
    assert simplest(["taxel_offset"], falls, fits) == "taxel_offset"


def test_of_effects_that_explain_as_much_but_for_nothing_the_one_with_fewest_numbers_is_named():
    of, options, values = case("hysteresis"), ChoiceOptions(), 20_000
    starts = {name: of.scene.bench.starts(name)[0] for name in ("cover", "dead_band", "taxel_gain")}
    fits = {name: replace(of.model, coords=start.coords) for name, start in starts.items()}
    assert len(fits["cover"].coords) < len(fits["dead_band"].coords)
    little = options.least(values)
    for first, second, expected in [
        (5000.0, 5000.0 - 0.7 * little, "cover"),
        (5000.0, 5000.0 - 0.9 * little, "dead_band"),  # less than 93 %
        (50_000.0, 50_000.0 - 0.9 * little, "cover"),
        (50_000.0, 50_000.0 - 1.1 * little, "dead_band"),
    ]:
        falls = {"dead_band": first, "cover": second, "taxel_gain": first + 10.0}
        assert fewest("dead_band", falls, fits, options, values) == expected
        assert fewest("cover", {**falls, "cover": first}, fits, options, values) == "cover"
        # What is not enough to be named does not take the place of what is.
        assert fewest("dead_band", falls, fits, options, values, enough=second + 1.0) == "dead_band"
        assert fewest("dead_band", falls, fits, options, values, enough=second - 1.0) == expected
        # Numbers for each taxel are compared before.
        assert fewest("taxel_gain", falls, fits, options, values) == "taxel_gain"


def test_what_was_read_off_is_named_first_and_alone():
    of, given = two()
    library, null = given
    usual = choose(of.model, of.made.material, library, null.p_value, null.mean_square)
    second = named(usual)[1]
    found = choose(of.model, of.made.material, library, null.p_value, null.mean_square, plain=(second,))
    first = found.named[0]
    assert first.name == second and first.consistent_with == (second,)
    assert set(named(found)) == set(named(usual))


def test_likeness_is_one_for_the_same_and_little_for_what_acts_otherwise():
    of = case("hysteresis")
    material = of.made.material
    views = of.scene.part(material.learn), of.scene.part(material.score)
    found = [best_of(of.scene, name, *views) for name in ("hysteresis", "creep", "taxel_offset")]
    first = Round(tuple(f for f in found if f is not None), 1.0, {})
    assert likeness(of.scene, material, first, "hysteresis", ["hysteresis"]) == pytest.approx(1.0)
    assert likeness(of.scene, material, first, "hysteresis", ["taxel_offset"]) < 0.2
    # What was not searched is searched; what cannot be is like nothing.
    assert 0.0 < likeness(of.scene, material, first, "rate", ["hysteresis"]) < 1.0
    assert likeness(of.scene, material, first, "dead_taxel", ["hysteresis"]) == 0.0
    assert likeness(of.scene, material, first, "hysteresis", []) == 0.0


def test_equations_for_the_same_thing_are_of_one_kind():
    assert of_one_kind("crosstalk", ["shear", "spread"]) and of_one_kind("creep", ["hysteresis"])
    assert not of_one_kind("crosstalk", ["hysteresis", "taxel_gain"]) and not of_one_kind("shear", ["shear"])
    assert {name for kind in KINDS for name in kind} <= set(EFFECTS)
    assert sum(len(kind) for kind in KINDS) == len({name for kind in KINDS for name in kind})


def test_what_the_equation_of_the_first_leaves_is_passed_over():
    one = made({"crosstalk": {"leak": 0.05}, "ghosting": {"row_leak": 0.02, "column_leak": 0.0}})
    model = based(one)
    of = Case(one, model, scene_of(one, model))
    library = Library.of(of.scene, ("crosstalk", "ghosting"))
    errors = {"fitted": np.zeros_like(of.scene.zero)}
    null = simulate_null(of.scene, one.material, library, errors, 100, np.random.default_rng(0))
    choice = chosen(of, (library, null))
    assert named(choice) == ("crosstalk",)
    # What was passed over is told.
    assert [(r.taken, r.passed_over) for r in choice.rounds[:2]] == [("crosstalk", None), (None, "ghosting")]
    # It is there, and named where so small a part of a kind may be.
    both = ChoiceOptions(of_related=0.0, of_all=0.0, share_later=0.2)
    assert set(named(chosen(of, (library, null), both))) == {"crosstalk", "ghosting"}


def test_what_takes_more_than_one_of_its_kind_goes_instead_of_it(monkeypatch: pytest.MonkeyPatch):
    one = made({"crosstalk": {"leak": 0.05}})
    model = based(one)
    of = Case(one, model, scene_of(one, model))
    library = Library.of(of.scene, ("crosstalk", "spread"))
    errors = {"fitted": np.zeros_like(of.scene.zero)}
    null = simulate_null(of.scene, one.material, library, errors, 100, np.random.default_rng(0))
    rounds = list[int]()

    def without_crosstalk_at_first(*given: Any, **more: Any) -> list[Found]:
        rounds.append(1)
        return [f for f in searched(*given, **more) if f.effect == "spread" or len(rounds) > 1]

    monkeypatch.setattr("skincal.gap.choose._searched", without_crosstalk_at_first)
    options = ChoiceOptions(share_first=0.0, halfway=0.0, of_related=2.0)
    choice = choose(model, one.material, library, null.p_value, null.mean_square, options)
    assert [r.taken for r in choice.rounds[:2]] == ["spread", "crosstalk"]
    assert named(choice) == ("crosstalk",) == choice.after.names and choice.explained > 0.9
    assert choice.named[0].p_value < 0.05 and 0 < choice.named[0].share <= 1
