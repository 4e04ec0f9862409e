"""A taxel that was found dead is where the search for dead taxels begins."""

from __future__ import annotations

import numpy as np
import pytest
from gap.gap_sessions import without
from gap.made_sessions import Made, made, pressed

from skincal.gap.candidates import Bench
from skincal.gap.dying import NAME, dead_start
from skincal.gap.free import parameters_at
from skincal.gap.hypothesis import Parameters
from skincal.gap.robust import Dead
from skincal.gap.session import GapSession

DEAD = (Dead(5, 100.0, 17.0, 0.0), Dead(1, 0.0, 3.0, 0.1))


def bench_of(one: Made, session: GapSession | None = None) -> Bench:
    return Bench(one.start, one.session if session is None else session)


def begun(bench: Bench) -> Parameters:
    """Parameters where the search begins."""
    start = dead_start(bench, DEAD)
    assert start is not None and start.effect == NAME
    return parameters_at(start.coords, np.array(start.x), start.held)[NAME]


def test_nothing_dead_no_start():
    assert dead_start(bench_of(made()), ()) is None


def test_the_search_begins_with_what_was_found():
    found = begun(bench_of(made()))
    answer, stuck, since = (np.array([1.0] * 9), np.zeros(9), np.zeros(9))
    answer[[5, 1]], stuck[[5, 1]], since[5] = (0.0, 0.1), (17.0, 3.0), 100.0
    assert found["answer"] == pytest.approx(answer)
    assert found["stuck_counts"] == pytest.approx(stuck)
    assert found["from_s"] == pytest.approx(since)


def test_values_are_those_of_the_dead_taxels_and_no_others():
    one = made()
    bench = bench_of(one)
    values, before = bench.values({NAME: begun(bench)}), one.start.values(one.session)
    elapsed = one.session.samples.elapsed_s
    late = elapsed >= 100.0
    assert values[late, 5] == pytest.approx(17.0)
    assert values[~late, 5] == pytest.approx(before[~late, 5])
    assert values[:, 1] == pytest.approx(0.1 * before[:, 1] + 0.9 * 3.0)
    others = [0, 2, 3, 4, 6, 7, 8]
    assert values[:, others] == pytest.approx(before[:, others])


def test_only_dead_taxels_are_searched_and_the_moment_is_not():
    start = dead_start(bench_of(made()), DEAD)
    assert start is not None
    assert {(c.parameter.name, c.index) for c in start.coords} == {
        (name, taxel) for name in ("answer", "stuck_counts") for taxel in (1, 5)
    }
    assert len(start.x) == len(start.coords)


def test_without_a_clock_only_what_was_dead_throughout_is_looked_for():
    one = made()
    bench = bench_of(one, without(one.session, time_s=None))
    found = begun(bench)
    assert "from_s" not in found or not np.any(found["from_s"])
    assert found["answer"] == pytest.approx(np.where(np.arange(9) == 1, 0.1, 1.0))
    assert dead_start(bench, DEAD[:1]) is None


def test_columns_of_few_taxels_are_told_by_the_taxel_of_the_layout():
    one = made()
    few = pressed().of_taxels(np.array([0, 3, 4, 6, 7, 8]))
    start = dead_start(bench_of(one, few), DEAD)
    assert start is not None
    assert {c.index for c in start.coords} == {8, 3}
    held = start.held[NAME]["from_s"]
    assert held[8] == 100.0 and np.count_nonzero(held) == 1


def test_a_calibration_that_has_dead_taxels_is_not_searched_for_them_again():
    one = made({NAME: {"answer": [1.0] * 8 + [0.0]}})
    assert dead_start(Bench(one.truth, one.session), DEAD) is None
