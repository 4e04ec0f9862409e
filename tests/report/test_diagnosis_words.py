"""A diagnosis in the terminal: the verdict first, and what was named with what it explains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from report.diagnosis_cases import diagnosed

from skincal.diagnose.summary import summary
from skincal.effects import EFFECTS
from skincal.gap.choice import Round
from skincal.report.diagnosis_gap import closed_words
from skincal.report.diagnosis_story import effect_rows, headline, parameter_rows, verdict_sentences
from skincal.report.diagnosis_words import verdict_lines


def test_what_was_named_and_what_it_explains():
    found, _ = diagnosed("hysteresis")
    lines = verdict_lines(found)
    assert lines[0] == "Missing: hysteresis."
    assert lines[1].startswith("hysteresis (p = ") and "of what was left" in lines[1]
    assert "height" in lines[2]


def test_a_parameter_that_ended_at_its_bound_is_told():
    found, _ = diagnosed("hysteresis")
    effect = found.effects[0]
    assert effect.at_bound == () and "bound" not in " ".join(verdict_lines(found))
    high = EFFECTS["hysteresis"].parameter("height").high
    parameters = {**effect.parameters, "height": np.asarray(high * (1 - 1e-9))}
    stopped = replace(effect, parameters=parameters)
    assert stopped.at_bound == ("height",)
    told = replace(found, effects=(stopped,))
    assert "height at the bound of what is allowed" in " ".join(verdict_lines(told))
    assert [
        row.interval.endswith("at its bound") for row in parameter_rows(told) if row.name == "height"
    ] == [True]
    dead = replace(effect, name="dead_taxel", parameters={"answer": np.array([1.0, 0.0])})
    assert dead.at_bound == ()
    # What is neutral is at no bound, though an effect may only go one way from it.
    assert replace(effect, parameters={**effect.parameters, "height": np.asarray(0.0)}).at_bound == ()


def test_what_shows_in_the_places_is_said_to():
    found, _ = diagnosed("hysteresis")
    own = {"name": "contact_offset", "consistent_with": ("contact_offset",), "share": 0.4, "by_places": True}
    one = replace(found.effects[0], **own)
    lines = verdict_lines(replace(found, effects=(one,)))
    assert lines[0] == "Missing: contact_offset."
    assert "40 % of where presses turn out to be" in lines[1]
    told = " ".join(verdict_sentences(replace(found, effects=(one,))))
    assert "40 % of the variance of where presses turn out to be" in told and "null sessions did" not in told


def test_what_is_in_the_places_only_closes_no_gap_of_images():
    found, _ = diagnosed("hysteresis")
    gap = replace(found.gap, closed=-0.4, slack_before_m=0.94e-3, slack_after_m=0.82e-3)
    one = replace(found.effects[0], name="contact_offset", by_places=True)
    told = replace(found, gap=gap, effects=(one,))
    lines, story = " ".join(verdict_lines(told)), " ".join(verdict_sentences(told))
    assert "moved by 0.94 mm rms before, 0.82 after" in lines
    assert "0.94 mm rms from the measured" in story and "0.82 mm from those" in story
    assert not any("of the gap" in words for words in (lines, story)) and "-" not in closed_words(told)
    both = replace(told, effects=(*found.effects, one))
    assert "of the gap" in " ".join(verdict_lines(both)) and "% closed" in closed_words(both)


def test_what_images_tell_of_places_is_said_as_of_other_effects():
    found, _ = diagnosed("hysteresis")
    one = replace(found.effects[0], name="contact_offset", consistent_with=("contact_offset",), share=0.4)
    assert "40 % of what was left" in verdict_lines(replace(found, effects=(one,)))[1]
    assert "Images do not show it" not in " ".join(verdict_sentences(replace(found, effects=(one,))))


def test_nothing_missing():
    assert verdict_lines(diagnosed("none")[0])[0] == "Nothing is missing that these presses could show."


def test_what_closes_nothing_is_told():
    found, _ = diagnosed("hysteresis")
    wide_open = replace(found, verdict="unknown", effects=(), wide_open=True)
    assert "hysteresis shows, but with it" in verdict_lines(wide_open)[0]
    story = " ".join(verdict_sentences(wide_open))
    assert "stay off with it" in story and "is asked for" not in story
    (row,) = [row for row in effect_rows(wide_open) if row.name == "hysteresis"]
    assert row.outcome == "explains much, but not on presses nobody has fitted"
    told = summary(wide_open)
    assert told["taken_back"] == ["hysteresis"]
    assert told["gap"]["heldout_rmse_with_taken_back"] == found.gap.after
    assert told["gap"]["heldout_rmse_after"] == told["gap"]["heldout_rmse_before"] == found.gap.before
    assert (
        summary(found)["taken_back"] == [] and summary(found)["gap"]["heldout_rmse_with_taken_back"] is None
    )


def test_what_is_unknown_is_said_to_depend_on_something():
    found, _ = diagnosed("hysteresis")
    unknown = replace(found, verdict="unknown", effects=())
    assert unknown.depends_on.count("%") == 3 and " and " in unknown.depends_on
    assert f"it goes along with {unknown.depends_on}; these" in " ".join(verdict_lines(unknown))
    assert f"goes along with {unknown.depends_on}" in " ".join(verdict_sentences(unknown))
    assert (
        summary(unknown)["where"]
        == f"{found.where}; it goes along with {unknown.depends_on}; these shares overlap"
    )
    assert summary(found)["where"] == found.where and "goes along" not in " ".join(verdict_lines(found))
    bare = replace(unknown, signatures=())
    assert bare.depends_on == "" and summary(bare)["where"] == found.where
    one = replace(unknown, signatures=unknown.signatures[:1])
    assert one.depends_on.count("%") == 1 and " and " not in one.depends_on


def test_what_held_out_presses_refute_is_told():
    found, _ = diagnosed("hysteresis")
    refuted = replace(found, verdict="unknown", effects=(), refuted=True)
    assert verdict_lines(refuted)[0].startswith("Something is missing. hysteresis would explain it, but")
    assert summary(refuted)["refuted"] and not summary(found)["refuted"]
    unknown = replace(found, verdict="unknown", effects=())
    bare = replace(unknown, audit=replace(unknown.audit, effects={}))
    assert not bare.audit.cannot_see
    assert (
        verdict_lines(bare)[0]
        == headline(bare)
        == "Something is missing that none of the known effects explains."
    )
    static = replace(diagnosed("static")[0], verdict="unknown")
    hidden = len(static.audit.cannot_see)
    assert hidden > 3 and verdict_lines(static)[0] == headline(static)
    assert headline(static).endswith(f"of those that these presses can show; {hidden} others they cannot.")


def test_what_comes_closest_to_what_is_left_is_told():
    found, _ = diagnosed("hysteresis")
    last = Round((), 200.0, {"creep": 50.0, "rate": 20.0})
    choice = replace(found.choice, rounds=(*found.choice.rounds, last))
    left = replace(found, choice=choice, unexplained=True)
    assert choice.closest == ("creep", 0.25)
    assert any(
        line.endswith("is left; creep comes closest, and explains 25 % of that")
        for line in verdict_lines(left)
    )
    assert "what comes closest, creep, explains 25 % of that" in " ".join(verdict_sentences(left))
    taken = replace(choice, rounds=(*found.choice.rounds, replace(last, taken="creep")))
    assert taken.closest is None
    bare = replace(left, choice=replace(choice, rounds=(*found.choice.rounds, Round((), 200.0, {}))))
    assert any(line.endswith("is left; no known effect explains it") for line in verdict_lines(bare))


def test_next_to_nothing_left_is_not_told_as_nothing():
    found, _ = diagnosed("hysteresis")
    first = found.choice.excess[0]
    choice = replace(found.choice, excess=(first, 0.001 * first))
    lines = verdict_lines(replace(found, choice=choice, unexplained=True))
    assert any(line.startswith("less than 1 % of the excess residual is left") for line in lines)


def test_without_a_gap_no_share_of_it_is_told():
    found, _ = diagnosed("hysteresis")
    nothing = float("nan")
    found = replace(found, gap=replace(found.gap, closed=nothing, interval=(nothing, nothing)))
    told = [" ".join(verdict_lines(found)), " ".join(verdict_sentences(found)), closed_words(found)]
    assert not any("nan" in words for words in told)
    assert all("no gap" in words for words in told)
