"""The rules that cut a series: levels, holds, contacts, plateaus."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skincal.imports.cutting import contacts, cut, cut_by_taxels, hold_of, kept_level, slopes
from skincal.imports.mapping_file import CutRules
from skincal.imports.recording import Series, runs


def trapeze(
    level: float, ramp_s: float, hold_s: float, rate_hz: float = 100.0
) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(0.0, 2 * ramp_s + hold_s, 1 / rate_hz)
    return time, np.interp(time, [0, ramp_s, ramp_s + hold_s, 2 * ramp_s + hold_s], [0, level, level, 0])


@settings(max_examples=60)
@given(
    level=st.floats(0.3, 20),
    ramp_s=st.floats(0.05, 2.0),
    hold_s=st.floats(0.3, 3.0),
    noise=st.floats(0.0, 0.01),
    spikes=st.integers(0, 2),
    seed=st.integers(0, 99),
)
def test_level_and_hold_of_any_trapeze(
    level: float, ramp_s: float, hold_s: float, noise: float, spikes: int, seed: int
):
    time, force = trapeze(level, ramp_s, hold_s)
    generator = np.random.default_rng(seed)
    force = force * (1 + noise * generator.normal(size=len(force)))
    force[generator.integers(0, len(force), spikes)] *= 5
    assert kept_level(time, force, 0.1) == pytest.approx(level, rel=0.05)
    hold = hold_of(time, force, CutRules())
    assert not isinstance(hold, str)
    start, stop = time[hold[0]], time[hold[1] - 1]
    # The band ends 2.5 % below the level: a ramp gives no more than that share of its time to the hold.
    slack = 0.05 * ramp_s + 3 * 0.01
    assert start == pytest.approx(ramp_s, abs=slack)
    assert stop == pytest.approx(ramp_s + hold_s, abs=slack)


def test_a_long_slow_ramp_is_not_the_hold():
    time = np.arange(0, 6, 0.01)
    force = np.interp(time, [0, 4, 5, 6], [0, 2, 2, 0])
    hold = hold_of(time, force, CutRules())
    assert not isinstance(hold, str)
    assert time[hold[0]] == pytest.approx(4.0, abs=0.2)
    assert time[hold[1] - 1] == pytest.approx(5.0, abs=0.1)


def test_relaxing_force_is_one_hold():
    time = np.arange(0, 3, 0.01)
    force = np.interp(time, [0, 0.3, 2.7, 3], [0, 2.1, 1.95, 0])
    hold = hold_of(time, force, CutRules())
    assert not isinstance(hold, str)
    assert time[hold[1] - 1] - time[hold[0]] > 2.0


def test_contacts_have_hysteresis():
    force = np.array([0, 0.15, 0.15, 0, 0, 0.15, 0.3, 0.15, 0.3, 0.05, 0])
    series = Series(np.arange(11.0), force, np.zeros(11, dtype=np.int64))
    assert contacts(series, CutRules(on_n=0.2, off_n=0.1)) == [(5, 9)]


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_no_part_of_a_contact_is_rest_by_the_taxels(noise: float):
    """Weak images of the ramps, below the thresholds of a contact, would raise the level of rest."""
    rng = np.random.default_rng(1)
    level = np.concatenate([trapeze(scale, 0.4, 0.6)[1] for scale in rng.uniform(0.4, 1, 10)])
    share = np.concatenate([[*np.zeros(90), *one] for one in level.reshape(10, -1)] + [np.zeros(60)])
    images = 500 + share[:, None] * [5, 30, 60, 80] + noise * rng.standard_normal((len(share), 4))
    part = np.zeros(len(share), dtype=np.int64)
    found = cut_by_taxels(Series(np.arange(float(len(share))), np.ones(len(share)), part), images, CutRules())
    assert len(found.spans) == 10
    idle = np.ones(len(share), dtype=bool)
    for span in found.spans:
        idle[span.start : span.stop] = False
    assert share[idle].max() < (0.03 if noise else 1e-9)  # twice the noise of a sum
    assert idle.sum() > 0.9 * (share == 0).sum()


def test_no_contact_goes_from_one_file_to_the_next():
    time = np.arange(40) * 0.1
    series = Series(time, np.full(40, 2.0), np.repeat([0, 1], 20))
    found = cut(series, CutRules())
    assert [(span.start, span.stop) for span in found.spans] == [(0, 20), (20, 40)]


@settings(max_examples=50)
@given(st.lists(st.booleans(), max_size=30))
def test_runs_are_the_stretches(mask: list[bool]):
    found = runs(np.array(mask, dtype=bool))
    again = np.zeros(len(mask), dtype=bool)
    for start, stop in found:
        assert start < stop
        again[start:stop] = True
        assert stop == len(mask) or not mask[stop]
    assert again.tolist() == mask


def test_slopes_of_a_line_are_the_lines():
    time = np.sort(np.random.default_rng(1).uniform(0, 5, 200))
    np.testing.assert_allclose(slopes(time, 3 * time - 1, 0.5), 3.0, rtol=1e-9)
    assert np.isinf(slopes(time[:1], time[:1], 0.5)).all()


def test_hold_has_no_gap():
    """Samples are lost, or the clock is set, in the ramp of a contact: the level is that of what was recorded."""
    time, force = trapeze(2.0, 0.5, 1.0)
    for at in (30, 80):  # in the ramp, in the hold
        hold = hold_of(time + np.where(np.arange(len(time)) >= at, 3600.0, 0.0), force, CutRules())
        assert not isinstance(hold, str)
        assert hold[0] == pytest.approx(max(at, 50), abs=3) and hold[1] == pytest.approx(150, abs=3)
