"""Which of two answers counts: the one without glitches, or the one of all presses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from skincal.diagnose.answer import Answer, Question
from skincal.diagnose.cache import Cache
from skincal.diagnose.options import DiagnoseOptions

WITHOUT, ALL = "without", "all"


def asked(
    monkeypatch: pytest.MonkeyPatch,
    without: tuple[str, bool],
    everything: str,
    *,
    differ: bool = True,
    explained: bool = True,
) -> str:
    """The answer that counts, of two with these verdicts."""
    base = cast("Any", type("Base", (), {"glitches": np.array([3])})())
    one = Answer(base, *([cast("Any", None)] * 3), *cast("Any", without))
    answers = {True: one, False: replace(one, verdict=cast("Any", everything), unexplained=False)}
    choice = cast("Any", type("Choice", (), {"after": None})())

    def answer(self: Question, rng: np.random.Generator, *, leave_out: bool) -> Answer:
        return replace(answers[leave_out], choice=choice)

    monkeypatch.setattr(Question, "_answer", answer)
    monkeypatch.setattr("skincal.diagnose.answer.may_be_effect", lambda _: differ)
    monkeypatch.setattr("skincal.diagnose.answer.explains", lambda *_: explained)
    heard: list[str] = []
    question = Question(cast("Any", None), cast("Any", None), DiagnoseOptions(), 0, Cache(), heard.append)
    found = question.answer(np.random.default_rng(0))
    assert bool(heard) == (differ and without != ("effects", False))
    return ALL if (found.verdict, found.unexplained) == (everything, False) else WITHOUT


def test_presses_that_stand_alone_were_glitches(monkeypatch: pytest.MonkeyPatch):
    assert asked(monkeypatch, ("none", False), "effects", differ=False) == WITHOUT


def test_an_effect_that_explains_all_presses_is_named(monkeypatch: pytest.MonkeyPatch):
    for without in (("none", False), ("unknown", True), ("effects", True)):
        assert asked(monkeypatch, without, "effects") == ALL


def test_what_leaves_them_out_of_proportion_is_not(monkeypatch: pytest.MonkeyPatch):
    for without in (("none", False), ("unknown", True), ("effects", True)):
        assert asked(monkeypatch, without, "effects", explained=False) == WITHOUT


def test_what_all_presses_show_and_nothing_explains_is_unknown(monkeypatch: pytest.MonkeyPatch):
    assert asked(monkeypatch, ("none", False), "unknown") == ALL
    assert asked(monkeypatch, ("effects", True), "unknown") == WITHOUT
    assert asked(monkeypatch, ("unknown", True), "none") == WITHOUT


def test_an_effect_that_explains_the_others_stays(monkeypatch: pytest.MonkeyPatch):
    assert asked(monkeypatch, ("effects", False), "unknown") == WITHOUT
