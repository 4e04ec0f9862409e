"""Conversion of datasets to sessions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.diagnose_data import moving, still

from skincal.diagnosis.dataset_session import gap_session, pose_names, repeats, sites
from skincal.diagnosis.observed import observe
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


def test_rest_frame_with_force_is_left_out():
    """The end of an unloading, which a threshold has labelled as rest."""
    data = moving()
    frames = data.frames
    assert frames is not None
    force = 0.01 * np.random.default_rng(0).standard_normal(len(frames))
    last = np.flatnonzero((frames.phase[1:] == IDLE) & (frames.phase[:-1] != IDLE))[:2] + 1
    force = np.where(frames.phase == IDLE, force, frames.force_n)
    force[last] = 0.1
    session = gap_session(replace(data, frames=replace(frames, force_n=force)))
    assert session.frames.sum() == len(frames) - len(last)


def test_only_holds_of_noted_forces_are_used():
    """A weight has the same force in all frames of its press, also while it is laid on."""
    data = moving()
    frames = data.frames
    assert frames is not None
    weight = data.presses.force_n[np.maximum(data.frame_presses(), 0)]
    rests, noted = frames.phase == IDLE, frames.press == data.presses.press[3]
    one = replace(data, frames=replace(frames, force_n=np.where(noted, weight, frames.force_n)))
    every = replace(data, frames=replace(frames, force_n=np.where(rests, 0.0, weight)))
    phases = [gap_session(d).phase[gap_session(d).press == 3] for d in (data, one)]
    assert len(set(phases[0].tolist())) == 3 and set(phases[1].tolist()) == {HOLD}
    assert gap_session(every).frames.sum() == (rests | (frames.phase == HOLD)).sum()
    assert gap_session(one).presses == gap_session(every).presses == len(data.presses)


def test_presses_are_matched_by_number():
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


def test_presses_out_of_time_order_keep_their_rows():
    data = still(clock=True)
    order = np.random.default_rng(0).permutation(len(data.presses))
    session = gap_session(replace(data, presses=data.presses.select(order)))
    assert np.array_equal(order[session.press], np.arange(len(order)))
    assert (np.diff(session.remembered.time_s) >= 0).all()


def test_press_without_position_is_left_out():
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


def test_poses_of_unused_presses_are_numbered():
    data = still()
    poses = np.array(["A", "B", *["C"] * (len(data.presses) - 2)])
    force = data.presses.force_n.copy()
    force[0] = 0.0
    presses = replace(data.presses, force_n=force, columns={**data.presses.columns, "pose": poses})
    data = replace(data, presses=presses)
    session = gap_session(data)
    assert pose_names(data) == ("A", "B", "C")
    assert set(session.samples.pose[session.samples.touching].tolist()) == {1, 2}


def test_rest_has_covariates_of_last_press():
    data = moving()
    warmer = 20.0 + np.arange(len(data.presses))
    presses = replace(data.presses, columns={**data.presses.columns, "temperature_c": warmer})
    session = gap_session(replace(data, presses=presses))
    samples = session.samples
    before = np.maximum.accumulate(np.where(session.row >= 0, session.row, 0))
    assert samples.temperature_c == pytest.approx(warmer[before])


def test_subtracted_baseline_has_no_bounds():
    data = moving()
    sensor = replace(data.meta.sensor, baseline="subtracted")
    subtracted = replace(data, meta=replace(data.meta, sensor=sensor))
    noises = [
        observe(one, None, np.random.default_rng(0), keep=False).fitter.forward.noise
        for one in (subtracted, data)
    ]
    assert [n.low for n in noises] == [-np.inf, 0.0] and noises[0].high == np.inf
