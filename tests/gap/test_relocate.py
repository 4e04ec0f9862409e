"""A press that went downhill into the wrong valley is found again, and only such a press moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.made_sessions import OPTIONS, Made, counted, held, made, pressed

from skincal.calibrate.workers import mapper
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.problem import cost_of_presses
from skincal.gap.refit import refit
from skincal.gap.relocate import ambiguous, of_presses, relocated

AGAIN = replace(OPTIONS, settle=0, steps=4)


def objective(one: Made, start: Hypothesis) -> float:
    return refit(start, one.session, one.reading, AGAIN).objective


@pytest.mark.parametrize("kind", ["frames", "holds"])
def test_presses_that_were_led_astray_are_found_again(kind: str):
    one = made(session=pressed(14, 2) if kind == "frames" else held(14))
    places = one.truth.places.copy()
    places[[3, 8], :2] += [[6e-4, -5e-4], [-5e-4, 6e-4]]
    wide = replace(OPTIONS, position_sigma_m=3e-4)
    back = relocated(one.truth.with_places(places), one.session, one.reading, wide)
    costs = [
        cost_of_presses(h, one.reading.residual(h.values(one.session)), one.session, wide)
        for h in (back, one.truth)
    ]
    # Of a press at the border one image may be as right elsewhere.
    assert (costs[0] < costs[1] + 4).all()
    moved = (back.places != places).any(axis=1)
    assert moved[[3, 8]].all() and moved.sum() <= 4
    assert one.truth.model is back.model


def test_processes_find_the_same_places():
    one = made(session=pressed(14, 2))
    places = one.truth.places.copy()
    places[[3, 8], :2] += [[6e-4, -5e-4], [-5e-4, 6e-4]]
    wide = replace(OPTIONS, position_sigma_m=3e-4)
    near = relocated(one.truth.with_places(places), one.session, one.reading, wide)
    sent: list[int] = []
    with mapper(2) as spread:
        astray, elsewhere = one.truth.with_places(places), replace(wide, mapper=counted(spread, sent))
        far = relocated(astray, one.session, one.reading, elsewhere)
    assert sent == [2]
    assert np.array_equal(far.places, near.places) and (near.places != places).any()


def test_a_fit_from_a_wrong_sensor_ends_as_one_from_the_truth():
    """Without a second look these sessions end 20 to 900 above it."""
    away = np.array([3e-4, -2e-4, 0.03, 0.15, -0.1])
    before, after = [], []
    for seed in (1, 2):
        one = made(session=pressed(14, seed), seed=seed)
        found = refit(one.start.moved(away), one.session, one.reading, OPTIONS)
        best = objective(one, one.truth)
        again = relocated(found.hypothesis, one.session, one.reading, OPTIONS)
        before.append(found.objective - best)
        after.append(objective(one, again) - best)
    assert min(before) > 20
    assert max(after) < 6


def test_presses_that_are_where_they_belong_stay():
    one = made()
    found = refit(one.start, one.session, one.reading, OPTIONS)
    again = relocated(found.hypothesis, one.session, one.reading, OPTIONS)
    moved = np.flatnonzero((again.places != found.hypothesis.places).any(axis=1))
    assert len(moved) <= 2
    costs = [
        cost_of_presses(h, one.reading.residual(h.values(one.session)), one.session, OPTIONS)
        for h in (found.hypothesis, again)
    ]
    assert (costs[1] <= costs[0] + 1e-9).all()


def test_no_press_is_looked_for_beyond_its_reach():
    one = made()
    places = one.truth.places.copy()
    places[5, :2] += 8e-4
    near = relocated(one.truth.with_places(places), one.session, one.reading, OPTIONS, reach_m=1e-5)
    assert np.hypot(*near.places[5, :2]) < 8e-4


def test_some_presses_of_a_session_are_what_they_are_in_it():
    one = made({"crosstalk": {"leak": 0.05}})
    rows = np.array([2, 7, 11])
    some, read = of_presses(one.session, one.reading, rows)
    keep = np.isin(one.session.press, rows)
    values = one.truth.values(one.session)
    assert one.truth.values(some) == pytest.approx(values[keep], abs=1e-9)
    assert (read.residual(values[keep]) == one.reading.residual(values)[keep]).all()
    costs = [
        cost_of_presses(one.truth, r.residual(one.truth.values(s)), s, OPTIONS)
        for s, r in ((some, read), (one.session, one.reading))
    ]
    assert costs[0][rows] == pytest.approx(costs[1][rows])
    static = made(session=held(12))
    part, _ = of_presses(static.session, static.reading, rows)
    assert static.truth.values(part) == pytest.approx(static.truth.values(static.session)[rows], abs=1e-9)


WIDE = replace(OPTIONS, position_sigma_m=8e-4)


def ends_from_around(one: Made, reach_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Where presses end (16, P, 2), and at what cost (16, P), that go downhill from two rings around the truth."""
    down = replace(WIDE, base=False, settle=16, steps=16)
    places, costs = [], []
    for turn in range(16):
        start = one.truth.places.copy()
        way = np.pi * (turn % 8) / 4
        start[:, :2] += reach_m * (1 + turn // 8) * np.array([np.cos(way), np.sin(way)])
        end = refit(one.truth.with_places(start), one.session, one.reading, down)
        places.append(end.hypothesis.places[:, :2])
        costs.append(cost_of_presses(end.hypothesis, end.slopes.residual, one.session, WIDE))
    return np.array(places), np.array(costs)


def test_presses_are_ambiguous_that_end_elsewhere_from_other_starts():
    one = made(session=pressed(30, 4))
    places, costs = ends_from_around(one, 9e-4)
    here = cost_of_presses(one.truth, one.reading.residual(one.truth.values(one.session)), one.session, WIDE)
    apart = np.hypot(*np.moveaxis(places - one.truth.places[:, :2], -1, 0)) > WIDE.position_sigma_m
    either = (apart & (costs < here + 8)).any(axis=0)
    said = ambiguous(one.truth, one.session, one.reading, WIDE)
    assert 3 <= either.sum() <= 24
    assert said[either].mean() > 0.5
    assert said[~either].mean() < 0.2


def test_of_several_valleys_the_best_is_taken():
    one = made(session=pressed(14, 2))
    _, around = ends_from_around(one, 9e-4)
    moved = one.truth.places.copy()
    moved[:, :2] += [1.2e-3, 0.0]
    back = relocated(one.truth.with_places(moved), one.session, one.reading, WIDE)
    down = refit(back, one.session, one.reading, replace(WIDE, base=False, settle=8, steps=8))
    costs = cost_of_presses(down.hypothesis, down.slopes.residual, one.session, WIDE)
    alone = refit(
        one.truth.with_places(moved), one.session, one.reading, replace(WIDE, base=False, settle=8, steps=8)
    )
    without = cost_of_presses(alone.hypothesis, alone.slopes.residual, one.session, WIDE)
    good, before = ((own < around.min(axis=0) + 16).mean() for own in (costs, without))
    assert good > 0.8 > before


def test_under_uniform_pressure_no_press_is_looked_for():
    one = made(session=pressed(14, 2))
    places = one.truth.places.copy()
    places[:, 0] += 1.2e-3
    found, still = one.truth.with_places(places), replace(WIDE, base=False)
    assert relocated(found, one.session, one.reading, still) is found
    assert not ambiguous(found, one.session, one.reading, still).any()
