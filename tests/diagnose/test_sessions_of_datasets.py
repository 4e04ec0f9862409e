"""A dataset as the diagnosis sees it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.diagnose_data import META, moving, still

from skincal.diagnose.base import floor_of, guessed_model
from skincal.diagnose.session import gap_session, pose_numbers, repeats, sites
from skincal.effects.samples import HOLD, IDLE


def test_frames_become_bins_with_their_covariates():
    data = moving()
    session = gap_session(data)
    assert session.has_frames and session.presses == len(data.presses)
    assert session.frames.sum() == len(data.frames)
    assert session.counts is not None and session.counts.shape == (len(session), 16)
    samples = session.samples
    assert samples.pose is not None and samples.cycle is not None and samples.temperature_c is None
    first = samples.pose[(session.press == 1)]
    assert set(first.tolist()) == {["A", "B"].index(str(data.presses.columns["pose"][1]))}
    held = (session.press == 3) & (session.phase == HOLD)
    mean = (session.counts[held] * session.frames[held, None]).sum(axis=0) / session.frames[held].sum()
    assert np.allclose(mean, data.presses.counts[3])
    assert (session.press[session.phase == IDLE] == -1).all()


def test_presses_are_told_by_their_number_not_by_their_row():
    data = moving()
    order = np.random.default_rng(0).permutation(len(data.presses))
    mixed = replace(data, presses=data.presses.select(order))
    one, two = gap_session(data), gap_session(mixed)
    pressed = one.press >= 0
    assert np.array_equal(order[two.press[pressed]], one.press[pressed])
    assert np.allclose(two.samples.cycle[pressed], one.samples.cycle[pressed])


def test_presses_without_frames_are_hold_means():
    session = gap_session(still())
    assert not session.has_frames and len(session) == len(still().presses)
    assert session.samples.time_s is None and session.samples.phase is None
    assert gap_session(still(clock=True)).samples.time_s is not None


def test_presses_in_another_order_than_time_keep_their_rows():
    data = still(clock=True)
    order = np.random.default_rng(0).permutation(len(data.presses))
    session = gap_session(replace(data, presses=data.presses.select(order)))
    assert np.array_equal(order[session.press], np.arange(len(order)))
    assert (np.diff(session.remembered.time_s) >= 0).all()


def test_a_press_without_place_is_left_out():
    data = still()
    place = data.presses.position_m.copy()
    place[2] = np.nan
    session = gap_session(replace(data, presses=replace(data.presses, position_m=place)))
    assert 2 not in session.press and len(session) == len(data.presses) - 1


def test_sites_and_repeats():
    data = moving()
    assert len(set(sites(data)[::4].tolist())) == 1
    first, second = repeats(data)
    assert first.tolist() == [0, 4, 8] and second.tolist() == [4, 8, 12]
    assert len(repeats(still())[0]) == 0


def test_poses_are_numbered_by_name():
    assert pose_numbers(np.array(["B", "A", "", "B"])).tolist() == [1, 0, -1, 1]


def test_scale_is_guessed_from_the_counts():
    model = guessed_model(moving(), gap_session(moving()))
    assert model.scale_per_n == pytest.approx(70, rel=0.35)
    assert model.readout.value_max == META.sensor.value_max


def test_noise_of_frames_and_of_means():
    framed, means = (floor_of(d, None, np.random.default_rng(0)) for d in (moving(), still()))
    assert framed.frame_from == "hold frames" and framed.frame_counts == pytest.approx(1.0, rel=0.12)
    assert framed.mean_counts == pytest.approx(1.04 / np.sqrt(12), rel=0.12)
    assert means.frame_counts == pytest.approx(1.0, rel=0.2)
    assert means.mean_counts == pytest.approx(1.04 / np.sqrt(12), rel=0.35)
