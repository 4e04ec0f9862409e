"""The report of a diagnosis says what was found, draws every view, and needs nothing from elsewhere."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from report.diagnosis_cases import diagnosed

from skincal.calibration import Finding
from skincal.cli.common import plain
from skincal.diagnose.summary import summary
from skincal.effects import EFFECTS
from skincal.report.diagnosis import PAGE, SECTIONS, SUMMARY, _page, write_diagnosis_report
from skincal.report.diagnosis_candidates import candidates_figure, critical_score, units
from skincal.report.diagnosis_curves import curves_figure, explained, views_of
from skincal.report.diagnosis_gap import gap_figure, heldout_names, press_rms
from skincal.report.diagnosis_left import Part, edges_of, left_by, line_of
from skincal.report.diagnosis_story import (
    effect_rows,
    headline,
    method_sentences,
    parameter_rows,
    tone,
    verdict_sentences,
)
from skincal.report.diagnosis_views import OF_EFFECT, VIEWS
from skincal.report.diagnosis_where import excess
from skincal.report.style import png_bytes


class Tags(HTMLParser):
    """Checks that tags close, and keeps the text and the pictures."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.sources: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img"):
            self.open.append(tag)
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.text.append(data)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A folder for some kinds of diagnosis, with its report."""
    made: dict[str, Path] = {}
    for kind in ("hysteresis", "static"):
        found, data = diagnosed(kind)
        made[kind] = tmp_path_factory.mktemp(kind)
        write_diagnosis_report(found, data, made[kind], plain(summary(found)))
    return made


def read(page: str) -> tuple[Tags, str]:
    tags = Tags()
    tags.feed(page)
    assert tags.open == []
    return tags, " ".join(" ".join(tags.text).split())


def drawn(figure: Figure) -> set[str]:
    """Draws a figure and gives the titles of its axes."""
    FigureCanvasAgg(figure).draw()
    return {axes.get_title(loc="left") for axes in figure.axes} - {""}


@pytest.mark.parametrize("kind", ["hysteresis", "static"])
def test_page_holds_everything(kind: str, folders: dict[str, Path]):
    folder = folders[kind]
    tags, text = read((folder / PAGE).read_text(encoding="utf-8"))
    assert all(source.startswith("data:image/png;base64,") for source in tags.sources)
    assert len(tags.sources) == len(SECTIONS)
    assert {p.name for p in folder.iterdir()} == {PAGE, SUMMARY, *(f"{s.stem}.png" for s in SECTIONS)}
    found, _ = diagnosed(kind)
    assert headline(found) in text
    assert text.index(headline(found)) < 400, "the verdict comes first"
    assert all(" ".join(s.split()) in text for s in (*verdict_sentences(found), *method_sentences(found)))
    assert all(name in text for name in EFFECTS)
    told = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    assert told["verdict"] == found.verdict
    assert "nan" not in text.lower().split()
    assert re.findall(r"\( (\w+\.png) \)", text) == [
        f"{s.stem}.png" for s in sorted(SECTIONS, key=lambda s: s.place)
    ]


def test_without_pages_there_is_the_summary_only(tmp_path: Path):
    found, data = diagnosed("none")
    write_diagnosis_report(found, data, tmp_path, plain(summary(found)), pages=False)
    assert [p.name for p in tmp_path.iterdir()] == [SUMMARY]


def test_what_a_dataset_says_is_escaped():
    found, data = diagnosed("none")
    finding = Finding("glitch", "warning", "<b>press</b> `5`", "look <i>there</i>")
    _, text = read(_page(replace(found, findings=(finding,)), data, []))
    assert "<b>press</b> 5" in text
    assert "look <i>there</i>" in text


def test_named_effect_is_told_with_its_numbers():
    found, _ = diagnosed("hysteresis")
    assert [e.name for e in found.effects] == ["hysteresis"]
    assert headline(found) == "Missing: hysteresis."
    assert tone(found) == "found"
    assert tone(replace(found, unexplained=True)) == "attention"
    words = " ".join(verdict_sentences(found))
    assert f"falls from {found.gap.before:.3g} to {found.gap.after:.3g} counts" in words
    assert f"none of {len(found.null.laws)} null sessions" in words
    rows = {row.name: row for row in parameter_rows(found)}
    assert set(rows) == {"height", "width"}
    low, high = (float(end) for end in rows["height"].interval.split(" to "))
    assert low < float(rows["height"].value) < high
    assert abs(float(rows["height"].value) - 0.6) < 0.1
    outcomes = {row.name: row.outcome for row in effect_rows(found)}
    assert outcomes["hysteresis"] == "named and added"
    assert outcomes["shear"].startswith("cannot be seen: no shear_u_n")
    assert outcomes["crosstalk"] == "no sign of it, to first order"


def test_rivals_are_told():
    found, _ = diagnosed("hysteresis")
    both = replace(found.effects[0], consistent_with=("hysteresis", "latency"))
    found = replace(found, effects=(both,), unexplained=True)
    assert headline(found) == "Missing: hysteresis or latency."
    assert tone(found) == "attention"
    words = " ".join(verdict_sentences(found))
    assert "cannot tell it from latency; hysteresis is what was added" in words
    assert "something else is missing, too" in words
    assert {r.name: r.outcome for r in effect_rows(found)}["latency"] == "cannot be told from hysteresis"


def test_nothing_and_unknown_in_words():
    found, _ = diagnosed("none")
    assert (headline(found), tone(found)) == ("Nothing is missing that these presses could show.", "good")
    assert any("null sessions" in s for s in verdict_sentences(found))
    other, _ = diagnosed("hysteresis")
    unknown = replace(other, verdict="unknown", effects=(), unexplained=True)
    words = " ".join(verdict_sentences(unknown))
    assert tone(unknown) == "attention"
    assert "With hysteresis in the model" in words
    assert "goes along with the value while unloading" in words
    assert "unchanged" in words


def test_static_session_says_what_it_cannot_show():
    found, _ = diagnosed("static")
    words = " ".join(verdict_sentences(found))
    assert "could not show" in words
    assert "hysteresis" in words
    assert len(drawn(curves_figure(found))) == 2


def test_views_of_what_was_named():
    found, _ = diagnosed("hysteresis")
    views = views_of(found, left_by(found, found.choice.before))
    assert [v.name for v in views] == ["loop"]
    assert drawn(curves_figure(found)) == {
        "Against force, while loading and unloading: base model",
        "With hysteresis",
    }


def test_where_nothing_was_named_the_strongest_views_are_shown():
    found, _ = diagnosed("hysteresis")
    unknown = replace(found, verdict="unknown", effects=())
    before = left_by(found, found.choice.before)
    views = views_of(unknown, before)
    assert len(views) == 2
    falls = {v.name: explained(v, before) for v in VIEWS.values() if v.kind != "moves"}
    assert views[0].name == max(falls, key=lambda name: falls[name])
    assert len(drawn(curves_figure(unknown))) == 2


@pytest.mark.parametrize("kind", ["hysteresis", "static"])
def test_every_view_that_the_data_have_can_be_drawn(kind: str, monkeypatch: pytest.MonkeyPatch):
    named = diagnosed("hysteresis")[0].effects[0]
    found = replace(diagnosed(kind)[0], effects=tuple(replace(named, name=name) for name in VIEWS))
    monkeypatch.setattr("skincal.report.diagnosis_curves.OF_EFFECT", {name: name for name in VIEWS})
    monkeypatch.setattr("skincal.report.diagnosis_curves.MOST", len(VIEWS))
    titles = drawn(curves_figure(found))
    lacking = {name for name, view in VIEWS.items() if f"{view.title}: base model" not in titles}
    # Rests are all equally long in these sessions, and their frames few.
    needs_time = {"hold", "change", "session", "cycle", "rest", "speed"}
    assert lacking == {"shear", "temperature", "after"} | (needs_time if kind == "static" else set())


def test_an_effect_without_a_view_of_its_own_is_shown_by_those_that_explain_most(
    monkeypatch: pytest.MonkeyPatch,
):
    found = diagnosed("hysteresis")[0]
    unknown = replace(found, verdict="unknown", effects=())
    monkeypatch.setattr("skincal.report.diagnosis_curves.OF_EFFECT", {})
    left = left_by(found, found.choice.before)
    assert views_of(found, left) == views_of(unknown, left) != ()
    assert drawn(curves_figure(found))


def test_what_was_taken_back_is_drawn_as_not_added():
    found, data = diagnosed("hysteresis")
    figure = gap_figure(replace(found, verdict="unknown", effects=(), refuted=True), data)
    drawn(figure)
    ticks = [label.get_text() for label in figure.axes[1].get_xticklabels()]
    assert ticks == ["base\nmodel", "not\nadded", "noise\nalone"]
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert "with hysteresis, not added" in [text.get_text() for text in legend.get_texts()]


def test_every_effect_has_a_view():
    assert set(OF_EFFECT) == set(EFFECTS)
    assert set(OF_EFFECT.values()) <= set(VIEWS)


def test_loop_opens_before_and_closes_after():
    found, _ = diagnosed("hysteresis")
    for model, open_ in ((found.choice.before, True), (found.choice.after, False)):
        left = left_by(found, model)
        parts = VIEWS["loop"].parts(left)
        assert [p.label for p in parts] == ["loading", "hold", "unloading"]
        edges = edges_of(parts, left, 6)
        lines = {p.label: line_of(p, left, edges, ~left.heldout) for p in parts}
        wide = np.nanmean(lines["unloading"].y - lines["loading"].y)
        assert (wide > 0.1) if open_ else (abs(wide) < 0.02)


def test_line_is_the_gain_that_was_put_in():
    found, _ = diagnosed("none")
    left = left_by(found, found.choice.before)
    louder = replace(left, residual=0.2 * left.values)
    part = Part("", left.covariates.force_n[:, None], left.values, left.touching)
    line = line_of(part, louder, edges_of((part,), louder, 5), np.ones(len(left.owner), dtype=bool))
    known = np.isfinite(line.y)
    assert known.sum() >= 3
    np.testing.assert_allclose(line.y[known], 0.2, atol=1e-9)
    np.testing.assert_allclose(line.error[known], 0.0, atol=1e-9)
    assert (np.diff(line.x[known]) > 0).all()


def test_residual_is_noise_where_nothing_is_hidden():
    found, _ = diagnosed("none")
    left = left_by(found, found.choice.before)
    seen = left.weight > 0
    assert 0.85 < (left.white[seen] ** 2).mean() < 1.15
    assert abs(excess(left).sum()) < 0.1 * seen.sum()
    hidden, _ = diagnosed("hysteresis")
    assert excess(left_by(hidden, hidden.choice.before)).sum() > seen.sum()


def test_heldout_presses_are_named_and_add_up():
    found, data = diagnosed("hysteresis")
    names = heldout_names(found, data)
    assert len(names) == found.gap.presses
    assert set(names) <= {str(p) for p in data.presses.press}
    sums = found.gap.errors
    np.testing.assert_allclose(np.sqrt(sums[:, 0].sum() / sums[:, 3].sum()), found.gap.before)
    assert (press_rms(found)[:, 0] > press_rms(found)[:, 2]).all()


def test_critical_score_is_where_p_becomes_significant():
    found, _ = diagnosed("hysteresis")
    null, limit = found.null, found.options.choice.significant
    name = found.choice.rounds[0].found[0].effect
    critical = critical_score(found)
    assert null.p_value(name, 1.001 * critical * null.unit(name)) <= limit
    assert null.p_value(name, 0.999 * critical * null.unit(name)) > limit
    assert units(null, found.choice.rounds[0]).max() > critical


def test_how_a_round_ended_stands_above_it():
    found = diagnosed("hysteresis")[0]
    first, second = found.choice.rounds[:2]
    best = second.found[0].effect
    rounds = (first, replace(second, passed_over=best), replace(second, taken=best), second)
    ended = replace(found, choice=replace(found.choice, rounds=rounds))
    titles = [axes.get_title(loc="left") or axes.get_title() for axes in candidates_figure(ended).axes]
    assert titles[1] == "Round 1: beside the base model"
    assert titles[2].endswith(f"{best} passed over, of a kind with what was added")
    assert titles[3].endswith(f"{best} was added, and dropped at the end")
    assert titles[4].endswith("nothing was added")
    listed = summary(ended)["candidates"]
    assert [c["name"] for c in listed[1] if c["passed_over"]] == [best]
    assert not any(c["passed_over"] for c in (*listed[0], *listed[2], *listed[3]))


@pytest.mark.parametrize(
    "section", [s for s in SECTIONS if s.stem in ("gap", "signature", "where")], ids=lambda s: s.stem
)
def test_pictures_are_reproducible(section: Any, folders: dict[str, Path]):
    found, data = diagnosed("static")
    assert png_bytes(section.draw(found, data)) == (folders["static"] / f"{section.stem}.png").read_bytes()
