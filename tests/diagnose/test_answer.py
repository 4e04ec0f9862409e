"""Which of two answers counts: the one without glitches, or the one of all presses."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from gap.made_sessions import case

from skincal.diagnose import answer, base_fit
from skincal.diagnose.answer import Answer, Question
from skincal.diagnose.base_fit import Base, may_be_effect, with_law
from skincal.diagnose.cache import Cache
from skincal.diagnose.options import DiagnoseOptions
from skincal.gap.null import law_errors
from skincal.gap.problem import RefitOptions
from skincal.gap.twin import twins_for

NOTHING = cast("Any", None)


@dataclass(frozen=True)
class Ready:
    """Of a prepared session what is looked at here."""

    options: RefitOptions


PREPARED = cast("Any", Ready(RefitOptions()))


def of(verdict: str, unexplained: bool = False) -> Answer:
    base, choice = SimpleNamespace(glitches=np.array([3])), SimpleNamespace(after=object(), named=())
    return Answer(cast("Any", base), NOTHING, cast("Any", choice), (), cast("Any", verdict), unexplained)


def counts(
    monkeypatch: pytest.MonkeyPatch,
    without: Answer,
    everything: Answer,
    *,
    differ: bool = True,
    explained: bool = True,
) -> str:
    """Which of two answers counts."""
    heard: list[str] = []

    def explains(*given: object) -> bool:
        model, base, presses = given
        assert model is everything.choice.after and base is everything.base
        assert presses is without.base.glitches
        return explained

    monkeypatch.setattr(
        Question,
        "_base",
        lambda self, *, leave_out=True, late=(): ((without if leave_out else everything).base, {}),
    )
    monkeypatch.setattr(
        Question, "_answer", lambda self, base, errors, rng: without if base is without.base else everything
    )
    monkeypatch.setattr(answer, "may_be_effect", lambda base: differ and base is without.base)
    monkeypatch.setattr(answer, "explains", explains)
    monkeypatch.setattr(answer, "with_what_was_seen", lambda counted: counted)
    question = Question(PREPARED, NOTHING, DiagnoseOptions(), 0, Cache(), heard.append)
    found = question.answer(np.random.default_rng(0))
    settled = without.verdict == "effects" and not without.unexplained
    assert bool(heard) == (differ and not settled)
    if found is without:
        return "without"
    assert found.base is everything.base and found.doubted.tolist() == [3]
    return "all"


def test_presses_that_stand_alone_were_glitches(monkeypatch: pytest.MonkeyPatch):
    assert counts(monkeypatch, of("none"), of("effects"), differ=False) == "without"


def test_an_effect_that_explains_all_presses_is_named(monkeypatch: pytest.MonkeyPatch):
    for without in (of("none"), of("unknown", True), of("effects", True)):
        assert counts(monkeypatch, without, of("effects")) == "all"


def test_what_leaves_them_out_of_proportion_is_not(monkeypatch: pytest.MonkeyPatch):
    for without in (of("none"), of("unknown", True), of("effects", True)):
        assert counts(monkeypatch, without, of("effects"), explained=False) == "without"


def test_what_all_presses_show_and_nothing_explains_is_unknown(monkeypatch: pytest.MonkeyPatch):
    assert counts(monkeypatch, of("none"), of("unknown", True)) == "all"
    assert counts(monkeypatch, of("unknown", True), of("unknown", True)) == "without"
    assert counts(monkeypatch, of("effects", True), of("unknown", True)) == "without"
    assert counts(monkeypatch, of("unknown", True), of("none")) == "without"


def test_an_effect_that_explains_the_others_stays(monkeypatch: pytest.MonkeyPatch):
    assert counts(monkeypatch, of("effects"), of("unknown", True)) == "without"


def test_with_other_processes_all_presses_are_asked_ahead(monkeypatch: pytest.MonkeyPatch):
    done: list[str] = []

    def eager(function: Any, arguments: Any, /) -> Any:
        ((question, _),) = arguments
        assert question.ready.options.mapper is map
        done.append("ahead")
        return iter([function(one) for one in arguments])

    without, everything = (replace(of("none"), base=base) for base in (based([3]), based([])))
    everything = replace(everything, verdict="unknown")
    monkeypatch.setattr(
        Question,
        "_base",
        lambda self, *, leave_out=True, late=(): ((without if leave_out else everything).base, {}),
    )

    def told(self: Question, base: Base, errors: object, rng: np.random.Generator) -> Answer:
        assert rng.spawn(1)
        done.append("first" if base is without.base else "all")
        return without if base is without.base else everything

    monkeypatch.setattr(Question, "_answer", told)
    monkeypatch.setattr(answer, "may_be_effect", lambda _: True)
    for mapper, order in ((eager, ["ahead", "all", "first"]), (map, ["first", "all"])):
        done.clear()
        ready = replace(PREPARED, options=replace(PREPARED.options, mapper=mapper))
        question = Question(ready, NOTHING, DiagnoseOptions(), 0, Cache(), lambda _: None)
        found = question.answer(np.random.default_rng(0))
        assert done == order
        assert found.verdict == "unknown" and found.doubted.tolist() == [3]
        if mapper is eager:
            assert found.base.material.options.mapper is eager


def test_a_generator_that_was_sent_draws_the_same():
    ours, sent = (np.random.default_rng(4) for _ in range(2))
    theirs = pickle.loads(pickle.dumps(sent))
    for a, b in zip(ours.spawn(2), theirs.spawn(2), strict=True):
        assert (a.random(3) == b.random(3)).all()


def based(glitches: list[int]) -> Base:
    made = case("none")
    return Base(made.model, made.made.material, np.array(glitches, dtype=np.int64), (), ())


def test_only_a_press_that_has_a_say_is_asked_again(monkeypatch: pytest.MonkeyPatch):
    m = case("none").made.material
    press = m.session.press
    learned = int(press[m.known & (press >= 0)][0])
    kept = [int(p) for p in np.unique(press[press >= 0]) if not (m.known & (press == p)).any()]
    assert not may_be_effect(based([learned]))
    monkeypatch.setattr(base_fit, "others_differ", lambda *_: True)
    assert may_be_effect(based([learned])) and not may_be_effect(based([]))
    assert not may_be_effect(based(kept))


def test_a_law_that_is_allowed_for_twice_is_allowed_for_once():
    base = based([])
    m = base.material
    errors = law_errors(case("none").scene, m, twins_for(base.model.hypothesis, m.session))
    once = with_law(base, errors)
    law = once.material.law
    assert law is not None and law.shape[-1] > 0
    again = with_law(once, errors)
    assert again.material.law is not None
    np.testing.assert_allclose(again.material.law, law)


def test_taxels_that_are_silent_beside_what_was_named_are_left_out_and_it_is_asked_again(
    monkeypatch: pytest.MonkeyPatch,
):
    named, heard, seen = SimpleNamespace(after=object(), named=("ghosting",)), list[str](), ["taxel 3"]
    first = replace(of("effects", True), choice=cast("Any", named))
    last = replace(first, base=cast("Any", SimpleNamespace(glitches=np.array([3]))), unexplained=False)
    monkeypatch.setattr(
        Question, "_base", lambda self, *, leave_out=True, late=(): ((last if late else first).base, {})
    )
    monkeypatch.setattr(
        Question, "_answer", lambda self, base, errors, rng: first if base is first.base else last
    )
    monkeypatch.setattr(answer, "may_be_effect", lambda _: False)
    monkeypatch.setattr(answer, "with_what_was_seen", lambda counted: counted)
    question = Question(PREPARED, NOTHING, DiagnoseOptions(), 0, Cache(), heard.append)
    for beside, found in ((seen, last), ([], first)):
        monkeypatch.setattr(answer, "silent_beside", lambda base, after, beside=beside: beside)
        assert question.answer(np.random.default_rng(0)) is found
    assert heard == ["again, without taxels that fell silent"]
