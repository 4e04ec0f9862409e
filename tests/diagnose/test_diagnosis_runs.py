"""Diagnoses of small sessions: what must not sway them is set apart, and an interrupted one goes on where it was.

Null sessions are of the fitted law only, as in :mod:`report.diagnosis_cases`, so nothing is learned about false alarms.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import patch

import numpy as np
import pytest
from calibrations import make_calibration
from diagnose.diagnose_data import moving, still
from report.diagnosis_cases import LOOP, calibration, diagnosed, session

from skincal.calibration import Effect
from skincal.dataset import HOLD, IDLE, Dataset
from skincal.diagnose.answer import judged
from skincal.diagnose.cache import Cache
from skincal.diagnose.diagnosis import Diagnosis
from skincal.diagnose.held_back import without_silent_ones
from skincal.diagnose.listed import pulled
from skincal.diagnose.named import where_without
from skincal.diagnose.options import DiagnoseOptions
from skincal.diagnose.prepare import FINAL, SELECTION, TRAIN, Prepared, force_variance, prepare
from skincal.diagnose.summary import summary
from skincal.diagnose.workflow import diagnose
from skincal.errors import InputError, WorkError
from skincal.gap.choice import Choice, Named
from skincal.gap.choice_options import ChoiceOptions
from skincal.gap.noise import LEFT_BY_FIT
from skincal.gap.null import Null
from skincal.gap.refit import _descended as descended  # pyright: ignore[reportPrivateUsage]
from skincal.gap.robust import Dead, times
from skincal.gap.signatures import Signature
from skincal.gap.silent import Silent

OPTIONS = DiagnoseOptions(null_draws=40, choice=ChoiceOptions(significant=0.03, contenders=1, searched=3))
NO_NULL = Null((), {}, 1.0)


def ready(data: Dataset | None = None, **changes: Any) -> Prepared:
    given = moving() if data is None else data
    made = make_calibration(model=calibration().model, findings=(), **changes)
    return prepare(given, made, OPTIONS, np.random.default_rng(0))


def test_processes_come_to_the_same_diagnosis(monkeypatch: pytest.MonkeyPatch):
    several = replace(OPTIONS, choice=replace(OPTIONS.choice, contenders=2, contend=0.0))
    # Asked twice, the second time by another process if there is one, and that answer counts.
    monkeypatch.setattr("skincal.diagnose.answer.may_be_effect", lambda _: True)
    monkeypatch.setattr("skincal.diagnose.answer.explains", lambda *_: True)
    monkeypatch.setattr("skincal.diagnose.answer.judged", lambda *_: ("effects", True))
    heard: list[str] = []
    near, far = (diagnose(session(LOOP), calibration(), several, 0, heard.append, workers=n) for n in (1, 2))
    assert heard.count("again, with all presses") == 2
    assert [e.name for e in far.effects] == [e.name for e in near.effects] == ["hysteresis"]
    assert [sorted(r.fits) for r in far.choice.rounds] == [sorted(r.fits) for r in near.choice.rounds]
    assert len(near.choice.rounds[0].fits) == 2
    # Linear algebra with several threads rounds otherwise.
    np.testing.assert_allclose(far.choice.excess, near.choice.excess, rtol=0.01, atol=1.0)
    np.testing.assert_allclose(far.gap.after, near.gap.after, rtol=0.01)
    assert far.material.options.mapper is map


@cache
def prepared() -> Prepared:
    return ready()


def test_rest_belongs_to_the_press_before_it():
    one = prepared()
    assert set(one.split.part.tolist()) == {TRAIN, SELECTION, FINAL}
    pressed = one.session.press >= 0
    assert np.array_equal(one.part[pressed], one.split.part[one.session.press[pressed]])
    last = 0
    for k in np.flatnonzero(pressed)[0] + np.arange(40):
        last = int(one.session.press[k]) if pressed[k] else last
        assert one.part[k] == one.split.part[last]
    assert (one.part[: np.flatnonzero(pressed)[0]] == TRAIN).all()
    assert np.array_equal(one.is_part(TRAIN, FINAL), one.part != SELECTION)


def test_the_full_session_has_every_frame():
    one, frames = prepared(), moving().frames
    assert frames is not None and len(one.full) == len(frames) and (one.full.frames == 1).all()
    assert one.full.counts is not None
    np.testing.assert_array_equal(one.full.counts, frames.counts)


def test_the_sharper_of_data_and_fit_says_what_a_place_is_worth():
    loss = make_calibration().loss
    assert prepared().options.position_sigma_m == moving().meta.position.sigma_m
    sharp = ready(still(), loss=replace(loss, extra={"position_sigma_m": 2e-4}))
    assert sharp.options.position_sigma_m == 2e-4
    blunt = ready(still(), loss=replace(loss, extra={"position_sigma_m": 0.1}))
    assert blunt.options.position_sigma_m == moving().meta.position.sigma_m


def test_a_hold_mean_weighs_as_much_as_its_noise_says():
    one = ready(still())
    assert one.full is one.session and one.force_noise_n == 0.0
    bright = np.full((len(one.session), 16), 100.0)
    assert one.reading.deviation(bright) == pytest.approx(one.floor.mean_counts, rel=1e-6)


def unclipped() -> Dataset:
    """Hold means of a sensor whose level at rest is far from its bounds, so that nothing shows its noise."""
    data = still()
    return replace(data, meta=replace(data.meta, sensor=replace(data.meta.sensor, value_min=-50.0)))


def test_the_noise_that_is_told_of_hold_means_is_the_one_that_is_used():
    loss = make_calibration().loss
    one = ready(unclipped(), loss=replace(loss, extra={"noise_sigma_counts": 2.5}))
    bright = np.full((len(one.session), 16), 100.0)
    assert one.reading.deviation(bright) == pytest.approx(
        np.hypot(2.5, 12**-0.5) / np.sqrt(one.session.frames[0])
    )
    # Untouched taxels have shown how much it is at least.
    assert (one.floor.mean_counts, one.floor.mean_from) == (2.5, LEFT_BY_FIT) and one.floor.measured
    assert 0.0 < one.floor.mean_interval[0] < one.floor.mean_interval[1] == 2.5
    without = ready(unclipped(), loss=replace(loss, extra={}))
    assert without.floor.mean_from == "hold means" and without.floor.measured


def test_effects_of_the_calibration_are_known():
    one = ready(still(), effects=(Effect("crosstalk", {"leak": 0.03}),))
    assert one.known_effects["crosstalk"]["leak"] == 0.03
    assert one.start.effects["crosstalk"]["leak"] == 0.03
    assert prepared().known_effects == {}


def test_noise_of_the_force_is_noise_of_what_the_model_says():
    one = prepared()
    noise = 0.02
    variance = force_variance(one.start, one.session, noise)
    assert variance.shape == one.reading.counts.shape and not variance[one.session.press < 0].any()
    k = int(np.argmax(variance.max(axis=1)))
    places = one.start.places.copy()
    places[one.session.press[k], 2] += 0.01
    change = one.start.with_places(places).values(one.session)[k] - one.start.values(one.session)[k]
    force = one.session.samples.contacts.force_n[k]
    expected = (change / (0.01 * force) * noise) ** 2 / one.session.frames[k]
    assert variance[k] == pytest.approx(expected, rel=0.05, abs=1e-6)
    assert not force_variance(one.start, one.session, 0.0).any()


def test_no_places_and_too_few_presses_are_refused():
    data = moving()
    nowhere = replace(data, meta=replace(data.meta, position=replace(data.meta.position, sigma_m=np.inf)))
    with pytest.raises(InputError, match="Only of uniform pressure"):
        ready(nowhere)
    few = replace(still(), presses=still().presses.select(np.arange(11)))
    with pytest.raises(WorkError, match=r"expected 12 presses .* got 11"):
        ready(few)


@pytest.mark.parametrize("counts", [np.nan, 0.0, 9.0])
def test_frames_that_all_read_the_same_are_refused_though_the_table_has_images(counts: float):
    data = moving()
    assert data.frames is not None
    same = replace(data, frames=replace(data.frames, counts=np.full_like(data.frames.counts, counts)))
    with pytest.raises(WorkError, match="the same one, but for noise, in the frames of all 16 presses"):
        ready(same)


def test_frames_that_are_all_at_rest_are_told_as_what_they_are():
    data = moving()
    assert data.frames is not None
    idle = replace(data, frames=replace(data.frames, phase=np.full_like(data.frames.phase, IDLE)))
    with pytest.raises(WorkError, match=r"columns press and phase.*of 12 presses.*of 0 of 16"):
        ready(idle)


def test_a_calibration_of_another_sensor_is_refused():
    other = replace(calibration().sensor, pitch_m=(0.005, 0.005))
    with pytest.raises(InputError, match="Use a calibration of this sensor"):
        diagnose(moving(), replace(calibration(), sensor=other))


@pytest.mark.parametrize(
    ("named", "left", "times", "said"),
    [
        (False, 100.0, 0.0, ("none", False)),
        (False, 100.0, 4.9, ("none", False)),
        (False, 100.0, 5.1, ("unknown", True)),
        (True, 5.0, 0.0, ("effects", False)),
        (True, 20.0, 0.0, ("effects", True)),
        (True, 1e-9, 0.0, ("effects", False)),
        (True, 5.0, 50.0, ("effects", False)),
        (True, 26.0, 0.0, ("unknown", True)),
    ],
)
def test_verdicts(named: bool, left: float, times: float, said: tuple[str, bool]):
    names = (Named("creep", ("creep",), 0.9, 0.01),) if named else ()
    choice = Choice(cast("Any", None), cast("Any", None), names, (), (100.0, left), 200)
    sign = Signature("hold", "the value against time in the hold", 0.5, 0.01, times, 50.0)
    assert judged(choice, NO_NULL, [sign], DiagnoseOptions()) == said


def test_what_is_sure_but_weaker_than_any_effect_that_is_named_is_nothing():
    sign = Signature("hold", "the value against time in the hold", 0.5, 0.01, 50.0, 50.0)
    for values, said in ((200, ("unknown", True)), (4000, ("none", False))):
        choice = Choice(cast("Any", None), cast("Any", None), (), (), (100.0, 100.0), values)
        assert judged(choice, NO_NULL, [sign], DiagnoseOptions()) == said


def test_what_a_law_that_was_not_simulated_may_leave_is_nothing():
    options = DiagnoseOptions()
    choice = Choice(cast("Any", None), cast("Any", None), (), (), (150.0, 150.0), 3000)
    of_null = np.linspace(1.0, 20.0, 200)
    for fall, said in ((104.0, ("none", False)), (400.0, ("unknown", True))):
        sign = Signature.of(
            "hold", "the value in the hold", fall, 500.0, of_null, options.choice.least(3000, 0.0)
        )
        assert sign.times_null > options.structure
        assert judged(choice, NO_NULL, [sign], options) == said
        assert (options.strongest(choice, [sign]) > 0) == (said[0] == "unknown")


def test_a_residual_far_above_that_of_any_null_session_is_unknown_whatever_it_depends_on():
    null = Null(("fitted",) * 3, {}, 1.0, {}, np.array([-30.0, 5.0, 40.0]))
    for excess, said in ((500.0, ("unknown", True)), (210.0, ("unknown", True)), (190.0, ("none", False))):
        choice = Choice(cast("Any", None), cast("Any", None), (), (), (excess, excess), 360)
        assert judged(choice, null, [], DiagnoseOptions()) == said
    # Half the noise is little, however sure it is.
    few = Choice(cast("Any", None), cast("Any", None), (), (), (500.0, 500.0), 2100)
    assert judged(few, null, [], DiagnoseOptions()) == ("none", False)


def test_beside_a_named_effect_as_much_may_be_left_as_another_contact_law_leaves():
    sign = Signature("neighbours", "the mean of the neighbours", 0.5, 0.01, 50.0, 50.0)
    names = (Named("spread", ("spread",), 0.5, 0.01),)
    for named, left, said in (
        (names, 11.0, ("effects", False)),
        (names, 15.0, ("unknown", True)),
        ((), 11.0, ("unknown", True)),
    ):
        choice = Choice(cast("Any", None), cast("Any", None), named, (), (20.0, left), 200)
        assert judged(choice, NO_NULL, [sign], DiagnoseOptions()) == said


def test_a_small_part_of_very_much_is_still_something():
    names = (Named("creep", ("creep",), 0.9, 0.01),)
    for left, said in ((5.0, True), (0.1, False)):
        choice = Choice(cast("Any", None), cast("Any", None), names, (), (100.0, left), 10)
        assert judged(choice, NO_NULL, [], DiagnoseOptions()) == ("effects", said)


def spoilt(data: Dataset, change: Callable[[np.ndarray, np.ndarray, np.ndarray], None]) -> Dataset:
    """A session with its counts changed in place: of counts (M, 16), numbers of presses and times (M,)."""
    assert data.frames is not None
    frames, counts = data.frames, data.frames.counts.copy()
    change(counts, frames.press, frames.time_s)
    counts = np.clip(np.round(counts), 0, 255)
    means = [counts[(frames.press == p) & (frames.phase == HOLD)].mean(axis=0) for p in data.presses.press]
    presses = replace(data.presses, counts=np.array(means))
    return replace(data, frames=replace(frames, counts=counts), presses=presses)


def glitch(counts: np.ndarray, press: np.ndarray, time_s: np.ndarray) -> None:
    """Press 105 shows the image of something else."""
    del time_s
    own = press == 105
    noise = np.random.default_rng(0).normal(0.0, 0.9, (int(own.sum()), counts.shape[1]))
    counts[own] = counts[own][:, ::-1] + 60.0 + noise


def told(found: Diagnosis) -> str:
    return json.dumps(summary(found), sort_keys=True, allow_nan=False)


@pytest.fixture
def fitted_law(monkeypatch: pytest.MonkeyPatch) -> None:
    """Null sessions of the fitted law only: other laws take long."""
    monkeypatch.setattr("skincal.diagnose.base_fit.twins_for", lambda *_: ())


def test_an_interrupted_diagnosis_goes_on_and_ends_the_same(tmp_path: Path, fitted_law: None):
    through, data = diagnosed("hysteresis")

    def cut(stage: str) -> None:
        if "presses again" in stage:
            raise KeyboardInterrupt

    kept, fitted = Cache(tmp_path), list[int]()

    def counted(*given: Any) -> Any:
        fitted.append(1)
        return descended(*given)

    with patch("skincal.gap.refit._descended", counted):
        with pytest.raises(KeyboardInterrupt):
            diagnose(data, calibration(), OPTIONS, 1, cut, kept)
        first = len(fitted)
        with patch("skincal.diagnose.kept.simulate_null", side_effect=AssertionError("not from the cache")):
            again = diagnose(data, calibration(), OPTIONS, 1, cache=kept)
        second = len(fitted) - first
        # Nothing is left to fit or to look for.
        with patch("skincal.gap.relocate._followed", side_effect=AssertionError("not from the cache")):
            last = diagnose(data, calibration(), OPTIONS, 1, cache=kept)
    assert first >= 2 and second >= 1 and len(fitted) == first + second
    for other in (again, last):
        assert told(other) == told(through)
        assert other.calibration.effects == through.calibration.effects


def test_each_of_several_effects_is_told_by_what_is_left_without_it():
    found, data = diagnosed("hysteresis")
    choice, base = found.choice, SimpleNamespace(material=found.material, model=found.choice.before)
    (loop,) = choice.named
    whole = where_without(loop, choice, cast("Any", base), data)
    assert whole == found.effects[0].where == found.where
    # Beside another one that adds eight counts to one taxel, and nothing to the others.
    level = {"offset_counts": np.where(np.arange(16) == 9, 8.0, 0.0)}
    after = choice.after.hypothesis
    both = after.with_effects({**after.effects, "taxel_offset": level})
    pair = replace(choice, named=(loop, replace(loop, name="taxel_offset")))
    pair = replace(pair, after=replace(choice.after, refit=replace(choice.after.refit, hypothesis=both)))
    texts = [where_without(one, pair, cast("Any", base), data) for one in pair.named]
    # Without the level the loop is all that is left to see; without the loop the level is there, and wrong.
    assert "on taxel (2, 1)" in texts[0] and "(2, 1)" not in texts[1]
    by_places = replace(loop, name="contact_offset", by_places=True)
    assert "turn out to be" in where_without(by_places, pair, cast("Any", base), data)


def test_the_summary_is_that_of_the_contract():
    found = summary(diagnosed("hysteresis")[0])
    assert found["verdict"] == "effects" and [e["name"] for e in found["effects"]] == ["hysteresis"]
    assert set(found["effects"][0]) == {
        "name", "consistent_with", "p_value", "parameters", "intervals", "where", "share", "by_places", "at_bound",
        "calibrated",
    }  # fmt: skip
    last = diagnosed("hysteresis")[0].calibration.effects[0].parameters
    assert found["effects"][0]["calibrated"] == dict(last)
    low, high = found["effects"][0]["intervals"]["height"]
    assert low < found["effects"][0]["parameters"]["height"] < high
    assert "slack_rms_before_m" not in found["gap"]
    assert found["candidates"][0][0]["name"] == "hysteresis"
    assert found["candidates"][0][0]["score"] == max(c["score"] for c in found["candidates"][0])


@pytest.mark.slow
def test_a_glitch_press_is_listed_and_does_not_change_what_is_named(fitted_law: None):
    found = diagnose(spoilt(session(LOOP), glitch), calibration(), OPTIONS, 1)
    (one,) = found.findings
    assert one.code == "glitch" and "press 105" in one.text
    assert [e.name for e in found.effects] == ["hysteresis"]
    assert found.effects[0].parameters["height"] == pytest.approx(LOOP["hysteresis"]["height"], abs=0.1)


def last_reach(data: Dataset, least: float = 25.0) -> tuple[int, int]:
    """A taxel and the last press that reaches it, which lights it well."""
    assert data.frames is not None
    for k in reversed(range(len(data.presses.press))):
        later = data.presses.counts[k + 1 :].max(axis=0, initial=0.0)
        free = data.presses.counts[k] * (later < 2.0)
        if free.max() > least:
            return int(free.argmax()), int(data.presses.press[k])
    raise AssertionError("no press is the last one that reaches a taxel")


def test_a_taxel_that_dies_in_the_last_press_that_reaches_it_is_named(fitted_law: None):
    data = session({})
    taxel, press = last_reach(data)

    def dies(counts: np.ndarray, presses: np.ndarray, time_s: np.ndarray) -> None:
        begin = time_s[presses == press].min()
        counts[time_s >= begin, taxel] = 0.0

    found = diagnose(spoilt(data, dies), calibration(), OPTIONS, 1)
    assert found.verdict == "effects" and [e.name for e in found.effects] == ["dead_taxel"]
    answer = found.effects[0].parameters["answer"]
    assert np.flatnonzero(answer < 0.5).tolist() == [taxel]
    assert [f.code for f in found.findings] == ["dead_taxel"]
    (own,) = found.calibration.effects
    assert own.name == "dead_taxel" and np.flatnonzero(np.array(own.parameters["answer"]) < 0.5).tolist() == [
        taxel
    ]
    # What would show the gap has shown the fault: it is not told how much of it is closed.
    assert summary(found)["gap"]["closed"] is None


@pytest.mark.parametrize("kind", ["one press", "the last ones"])
def test_a_taxel_that_dies_before_the_last_presses_is_named(kind: str, fitted_law: None):
    data = session({})
    assert data.frames is not None
    press = data.presses.press
    taxel = 9 if kind == "one press" else last_reach(data)[0]
    # Of those presses that light the taxel well, the last two.
    begin = 17 if kind == "one press" else int(np.flatnonzero(data.presses.counts[:, taxel] > 25.0)[-2])

    def dies(counts: np.ndarray, presses: np.ndarray, time_s: np.ndarray) -> None:
        counts[time_s >= time_s[presses == press[begin]].min(), taxel] = 0.0

    found = diagnose(spoilt(data, dies), calibration(), OPTIONS, 1)
    assert [e.name for e in found.effects] == ["dead_taxel"], kind
    assert f"taxel_{taxel // 4}_{taxel % 4} " in " ".join(
        f.text for f in found.findings if f.code == "dead_taxel"
    )


@pytest.mark.parametrize(("taxels", "begin"), [((5, 6), 12), ((5, 10), 16)])
def test_taxels_that_die_together_are_all_named(taxels: tuple[int, int], begin: int, fitted_law: None):
    data = session({})

    def die(counts: np.ndarray, presses: np.ndarray, time_s: np.ndarray) -> None:
        late = time_s >= time_s[presses == data.presses.press[begin]].min()
        counts[np.ix_(late, taxels)] = 0.0

    found = diagnose(spoilt(data, die), calibration(), OPTIONS, 1)
    assert found.verdict == "effects" and [e.name for e in found.effects] == ["dead_taxel"]
    assert np.flatnonzero(found.effects[0].parameters["answer"] < 0.5).tolist() == list(taxels)
    assert sum(f.code == "dead_taxel" for f in found.findings) == 2


def test_the_end_shows_a_silent_taxel_only_where_others_have_shown_it_before():
    ready = prepare(session({}), calibration(), OPTIONS, np.random.default_rng(0))
    end = np.flatnonzero(ready.split.part == FINAL)
    first = np.flatnonzero(ready.split.part != FINAL)

    def seen_in(presses: list[int], falls: list[float], *, named: bool = True) -> bool:
        """Whether what the taxel read late in the session is looked at."""
        late = float(times(ready.session).max()) / 2
        rows, values = np.array(presses), np.array(falls)
        silent = Silent(Dead(9, late, 0.0, 0.0), (late, late), rows, 0 * values, values, values.sum(), 1.0)
        base = cast(Any, SimpleNamespace(silent=(silent,)))
        choice = cast(Any, SimpleNamespace(after=SimpleNamespace(names=("dead_taxel",) if named else ())))
        reading = without_silent_ones(ready, base, choice, ready.reading, ready.session)
        assert reading.seen[times(ready.session) < late].all()
        return bool(reading.seen[times(ready.session) >= late, 9].all())

    assert seen_in([int(first[0]), int(end[0])], [500.0, 300.0])
    assert not seen_in([int(first[0]), int(end[0])], [20.0, 500.0])
    assert not seen_in([int(first[0]), int(end[0])], [500.0, 20.0])
    assert not seen_in([int(first[0]), int(first[1])], [500.0, 500.0])
    assert not seen_in([int(first[0]), int(end[0])], [500.0, 300.0], named=False)


def test_presses_that_need_quite_another_force_are_told():
    ready = prepare(session({}), calibration(), OPTIONS, np.random.default_rng(0))
    places = ready.start.places.copy()
    places[[2, 5, 7], 2] = np.log([1.2, 0.85, 1.4])
    places[3, 2] = 3 * ready.options.force_sigma
    after = ready.start.with_places(places)
    assert pulled(after, ready, np.array([7])) == pytest.approx({2: 0.2, 5: -0.15})
    in_a_chamber = replace(ready, options=replace(ready.options, base=False))
    assert pulled(after, in_a_chamber, np.array([7])) == {}
