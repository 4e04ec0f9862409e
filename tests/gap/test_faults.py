"""Faults under load: stuck for a while, and groups of taxels that jump on a staircase."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from chambers import Chamber
from gap.made_sessions import held, made, pressed

from skincal.calibrate import calibrate_uniform
from skincal.dataset import read_dataset
from skincal.diagnose.options import DiagnoseOptions
from skincal.diagnose.prepare import Prepared, prepare
from skincal.gap.faults import jumps_under_load, rests_rarely, stuck_taxels, without_stuck
from skincal.gap.robust import without_jumps

GROUP, STUCK = (0, 1, 2, 3), (5,)


@cache
def chamber(group: tuple[int, ...] = (), stuck: tuple[int, ...] = (), memory: float = 0.0) -> Prepared:
    with TemporaryDirectory() as folder:
        session = Chamber.plain(group=group, stuck=stuck, memory=memory)
        data = read_dataset(session.write(Path(folder) / "chamber"))
    calibration = calibrate_uniform(data).calibration
    return prepare(data, calibration, DiagnoseOptions(), np.random.default_rng(0))


def test_a_staircase_rests_rarely_and_presses_do_not():
    assert rests_rarely(chamber().session)
    assert not rests_rarely(pressed(12))


def test_a_group_that_jumps_is_found_and_taken_off():
    ready = chamber(group=GROUP)
    values = ready.start.values(ready.session)
    (jump,) = jumps_under_load(values, ready.reading, ready.session)
    assert jump.taxels == GROUP
    assert jump.counts == pytest.approx([20.0] * 4, abs=2.0)
    assert np.isfinite(jump.until_s)
    without = without_jumps(ready.reading, ready.session, [jump])
    assert jumps_under_load(values, without, ready.session) == []


@pytest.mark.parametrize("memory", [0.0, 0.05])
def test_where_nothing_jumps_nothing_is_found(memory: float):
    ready = chamber(memory=memory)
    values = ready.start.values(ready.session)
    assert jumps_under_load(values, ready.reading, ready.session) == []
    assert stuck_taxels(values, ready.reading, ready.session) == []


def test_two_taxels_are_no_group():
    ready = chamber(group=(0, 1))
    assert jumps_under_load(ready.start.values(ready.session), ready.reading, ready.session) == []


def test_one_press_that_is_off_by_itself_is_no_jump_where_there_is_no_rest():
    one = made(session=held())
    values = one.truth.values(one.session)
    assert rests_rarely(one.session)
    for off, found in (((5,), 0), ((5, 6, 7), 1)):
        counts = np.array(one.reading.counts)
        counts[list(off)] += 25.0
        session = replace(one.session, counts=counts)
        assert len(jumps_under_load(values, replace(one.reading, counts=counts), session)) == found


def test_a_taxel_that_sticks_for_a_while_is_found_and_not_believed():
    ready = chamber(stuck=STUCK)
    (stuck,) = stuck_taxels(ready.start.values(ready.session), ready.reading, ready.session)
    assert (stuck.taxel, stuck.counts) == (5, 255.0)
    reading = without_stuck(ready.reading, ready.session, [stuck])
    lost = ready.reading.seen & ~reading.seen
    assert lost[:, 5].any() and not np.delete(lost, 5, axis=1).any()
    assert not (reading.counts[reading.seen[:, 5], 5] > 254).any()


def test_saturation_and_darkness_are_not_sticking():
    one = made()
    values = one.truth.values(one.session)
    assert stuck_taxels(values, one.reading, one.session) == []
    # A taxel that reads nothing to the end is dead, which is an effect.
    counts = one.session.counts.copy()
    counts[len(counts) // 2 :, int(values.max(axis=0).argmax())] = 0.0
    dead = replace(one.reading, counts=counts)
    assert stuck_taxels(values, dead, one.session) == []
