"""Diagnoses of generated sessions: named effects, no false alarms, and invariants of all answers."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from inference.made import DIES, FROM_S, KINDS, found, made
from report.diagnosis_cases import TRUTH, calibration, diagnose_quickly, diagnosed

from skincal.diagnosis.workflow import diagnose
from skincal.inference.candidate_scores import smooth_fitter
from skincal.inference.null import FOUNDATION, draw_noise

QUICK = (
    "nothing",
    "nothing, in steps of 8",
    "nothing, pressure itself",
    "hysteresis",
    "crosstalk",
    "dead_taxel, from a moment on",
    "wiring",
)
"""Kinds that differ most: rounding, another contact law, memory, taxels that mix, one that changes, wrong wires."""


def kinds(names: Iterable[str]) -> list[Any]:
    """Parameters of a test: all but the quick ones are slow."""
    return [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in names]


QUIET = [kind for kind in KINDS if kind.startswith("nothing")]
NAMED = [kind for kind in KINDS if kind not in (*QUIET, "wiring")]


@pytest.mark.parametrize("kind", kinds(QUIET))
def test_nothing_is_named_where_nothing_is_hidden(kind: str):
    assert (found(kind).verdict, found(kind).effects) == ("none", ())


def test_laws_of_the_null_are_named_for_readers():
    laws = dict.fromkeys(found(QUIET[0]).found.null.laws)
    assert list(laws) == ["fitted law", "layer 1 mm", "layer 3 mm", "layer 10 mm"]


@pytest.mark.parametrize("kind", kinds(NAMED))
def test_what_is_hidden_is_named(kind: str):
    (one,) = found(kind).effects
    assert kind.split(",")[0] in one.consistent_with
    assert one.gain > 8 and one.p_value < 0.05


@pytest.mark.parametrize("kind", kinds(NAMED))
def test_added_effects_keep_the_sensor_in_its_interval(kind: str):
    new = found(kind).calibration
    for name, true in TRUTH.best().items():
        low, high = new.intervals[name]
        # A little beyond the interval is one in twenty.
        assert low - 0.5 * (high - low) <= true <= high + 0.5 * (high - low), name


def test_a_fault_of_the_wiring_has_no_name():
    said = found("wiring")
    assert (said.verdict, said.taken_back) == ("unknown", ())
    assert "taxel_order" in [one.code for one in said.findings]
    # What looks like an effect in wrong images says nothing of the skin: none is looked for.
    assert not any(said.found.rounds)


@pytest.mark.parametrize("kind", kinds(KINDS))
def test_the_gap_is_no_contradiction(kind: str):
    gap = found(kind).gap
    assert gap.floor <= min(gap.before, gap.after) * (1 + 1e-9)
    assert not np.isfinite(gap.closed) or gap.closed <= 1.0 + 1e-9


@pytest.mark.parametrize("kind", kinds(["hysteresis", "creep"]))
def test_intervals_of_an_effect_hold_what_was_hidden(kind: str):
    (one,) = found(kind).effects
    for name, true in KINDS[kind]["effects"][kind].items():  # type: ignore[index]
        low, high = (float(x) for x in one.intervals[name])
        assert low - 0.5 * (high - low) <= true <= high + 0.5 * (high - low), name


def test_the_press_is_found_from_which_on_a_taxel_is_dead():
    said = found("dead_taxel, from a moment on")
    (one,) = said.effects
    seen = said.found.final.prediction
    begin = float(one.parameters["from_s"][DIES])
    # No press that it would feel lies between the moment and the one that was found.
    felt = seen.felt.elapsed_s[seen.loads[:, DIES] > 0.05 * seen.loads.max()]
    assert not ((felt > min(begin, FROM_S)) & (felt < max(begin, FROM_S))).any()
    assert (felt < begin).any() and (felt > begin).any()


@pytest.mark.parametrize("kind", kinds(kind for kind in QUIET if "steps" in kind))
def test_rounding_gains_an_effect_no_more_than_noise(kind: str):
    null = found(kind).found.null
    rounded = np.array(null.laws) == FOUNDATION
    assert max(gains[rounded].max() for gains in null.gains.values()) < 20


def test_rounding_has_no_mean_about_the_line():
    said, rng = found("nothing, in steps of 8"), np.random.default_rng(1)
    drawn = draw_noise(smooth_fitter(said.observed.fitter), said.found.base, rng, 400)
    assert np.abs(drawn.mean(axis=-1)).max() < 0.6


@pytest.mark.slow
def test_weak_effect_is_named_next_to_a_strong_one():
    levels = {"offset_counts": np.linspace(-12.0, 12.0, 16)}
    hidden = {"taxel_offset": levels, "hysteresis": {"height": 0.15, "width": 1.5}}
    data = made(hidden, rest=40.0)
    said = diagnose(data, replace(calibration(), sensor=data.meta.sensor), seed=1)
    gains = {one.name: one.gain for one in said.effects}
    assert set(gains) == set(hidden)
    # What the memory explains is next to nothing of what the levels do.
    assert gains["hysteresis"] < 0.02 * gains["taxel_offset"]


def test_fits_made_in_other_processes_change_nothing():
    sent = list[int]()

    def elsewhere(function: Callable[[Any], Any], arguments: Sequence[Any]) -> list[Any]:
        sent.append(len(arguments))
        tasks = pickle.loads(pickle.dumps(list(arguments)))
        return pickle.loads(pickle.dumps([function(task) for task in tasks]))

    here, data = diagnosed("hysteresis")
    there = diagnose_quickly(data, mapper=elsewhere)
    assert max(sent) > 1
    assert [e.name for e in here.effects] == [e.name for e in there.effects]
    assert here.calibration.model == there.calibration.model
    assert here.gap.closed == there.gap.closed
