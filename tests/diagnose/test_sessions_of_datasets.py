"""A dataset as the diagnosis sees it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.diagnose_data import META, moving, still
from report.diagnosis_cases import calibration

from skincal.dataset import Dataset
from skincal.diagnose.base import calibrated_model, floor_of, guessed_model
from skincal.diagnose.options import DiagnoseOptions
from skincal.diagnose.prepare import high_rest, prepare
from skincal.diagnose.session import gap_session, pose_names, readout_of, repeats, sites
from skincal.effects import EFFECTS
from skincal.effects.samples import HOLD, IDLE
from skincal.errors import WorkError
from skincal.gap.noise import assumed_floor


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


@pytest.mark.parametrize("data", [moving(), still(clock=True)], ids=["frames", "holds"])
def test_presses_in_another_order_than_time_are_looked_for_as_others(data: Dataset):
    order = np.random.default_rng(0).permutation(len(data.presses))
    mixed = replace(data, presses=data.presses.select(order))
    known = calibration({"taxel_offset": {"offset_counts": 30.0}})
    for of in (calibration(), known):
        one, two = (prepare(d, of, DiagnoseOptions(), np.random.default_rng(0)).start for d in (data, mixed))
        assert one.places.any()
        assert two.places == pytest.approx(one.places[order])


def test_places_are_looked_for_with_the_effects_that_are_known():
    known, data = calibration({"taxel_offset": {"offset_counts": 30.0}}), moving()
    meta = replace(data.meta, sensor=replace(data.meta.sensor, value_max=None))
    data = replace(data, meta=meta)
    high = replace(
        data,
        presses=replace(data.presses, counts=data.presses.counts + 30.0),
        frames=replace(data.frames, counts=data.frames.counts + 30.0),
    )
    low = prepare(data, calibration(), DiagnoseOptions(), np.random.default_rng(0)).start.places
    found = prepare(high, known, DiagnoseOptions(), np.random.default_rng(0)).start.places
    assert np.abs(found - low)[:, :2].max() < 0.5e-3 and np.median(np.abs(found - low)) < 1e-4


@pytest.mark.parametrize("value", [0.0, 7.0, 255.0, None])
@pytest.mark.parametrize("frames", [True, False])
def test_a_sensor_that_answers_nothing_is_refused(value: float | None, frames: bool):
    data, rng = moving(), np.random.default_rng(0)
    shape = data.frames.counts.shape
    counts = np.round(10 + rng.normal(size=shape)) if value is None else np.full(shape, value)
    held = np.array([counts[data.frames.press == p].mean(axis=0) for p in data.presses.press])
    data = replace(
        data,
        presses=replace(data.presses, counts=held),
        frames=replace(data.frames, counts=counts) if frames else None,
    )
    with pytest.raises(WorkError, match="all 16 presses"):
        prepare(data, calibration(), DiagnoseOptions(), rng)


@pytest.mark.parametrize("frames", [True, False])
def test_a_sensor_that_answers_in_small_numbers_is_not_refused(frames: bool):
    data = moving() if frames else still()
    sensor = replace(data.meta.sensor, value_min=None, value_max=None, integer=False)
    presses = replace(data.presses, counts=data.presses.counts / 1000)
    small = replace(data, meta=replace(data.meta, sensor=sensor), presses=presses)
    if frames:
        small = replace(small, frames=replace(data.frames, counts=data.frames.counts / 1000))
    found = calibration()
    few = replace(found.model, scale_per_n=found.model.scale_per_n / 1000)
    ready = prepare(small, replace(found, model=few), DiagnoseOptions(), np.random.default_rng(0))
    assert ready.session.presses == len(data.presses)


def test_without_frames_and_clipped_rest_repeats_bound_the_noise():
    """What a fit left is what the model lacks as well."""
    data, rng = still(), np.random.default_rng(0)
    targets = {name: moving().presses.columns[name] for name in ("target_x_m", "target_y_m", "target_z_m")}
    force = {"target_force_n": np.round(data.presses.force_n, 3)}
    presses = replace(data.presses, counts=data.presses.counts + 20.0, columns={**targets, **force})
    sensor = replace(data.meta.sensor, value_min=None, value_max=None)
    data = replace(data, meta=replace(data.meta, sensor=sensor), presses=presses)
    known = calibration()
    large = replace(known, loss=replace(known.loss, extra={"noise_sigma_counts": 3.0}))
    ready = prepare(data, large, DiagnoseOptions(), rng)
    assert ready.floor.mean_from == "repeats"
    assert np.max(ready.reading.sigma_counts) < 1.0


def test_sites_and_repeats():
    data = moving()
    assert len(set(sites(data)[::4].tolist())) == 1
    first, second = repeats(data)
    assert first.tolist() == [0, 4, 8] and second.tolist() == [4, 8, 12]
    assert len(repeats(still())[0]) == 0


def test_poses_are_numbered_by_name_those_of_presses_that_are_not_used_as_well():
    data = still()
    poses = np.array(["A", "B", *["C"] * (len(data.presses) - 2)])
    force = data.presses.force_n.copy()
    force[0] = 0.0
    presses = replace(data.presses, force_n=force, columns={**data.presses.columns, "pose": poses})
    data = replace(data, presses=presses)
    session = gap_session(data)
    assert pose_names(data) == ("A", "B", "C")
    assert set(session.samples.pose[session.samples.touching].tolist()) == {1, 2}


def test_rest_has_the_covariates_of_the_press_before():
    data = moving()
    warmer = 20.0 + np.arange(len(data.presses))
    presses = replace(data.presses, columns={**data.presses.columns, "temperature_c": warmer})
    session = gap_session(replace(data, presses=presses))
    samples = session.samples
    before = np.maximum.accumulate(np.where(session.row >= 0, session.row, 0))
    assert samples.temperature_c == pytest.approx(warmer[before])


def test_where_rest_was_taken_off_nobody_knows_the_bounds():
    data = moving()
    sensor = replace(data.meta.sensor, baseline="subtracted")
    readout = readout_of(replace(data, meta=replace(data.meta, sensor=sensor)))
    assert (readout.value_min, readout.value_max, readout.rest_subtracted) == (None, None, True)
    assert readout_of(data).value_min == 0


def test_scale_is_guessed_from_what_is_above_rest():
    data = moving()
    high = replace(data, presses=replace(data.presses, counts=data.presses.counts + 100.0))
    frames = replace(data.frames, counts=data.frames.counts + 100.0)
    high = replace(high, frames=frames)
    guessed = [guessed_model(one, gap_session(one)).scale_per_n for one in (data, high)]
    assert guessed[1] == pytest.approx(guessed[0], rel=0.05)


def test_scale_is_guessed_from_the_counts():
    model = guessed_model(moving(), gap_session(moving()))
    assert model.scale_per_n == pytest.approx(70, rel=0.35)
    assert model.readout.value_max == META.sensor.value_max


def test_means_of_holds_are_told_by_finer_points_than_frames():
    points = [len(calibrated_model(calibration(), one).skin.skin.patch) for one in (moving(), still())]
    assert points[1] > 3 * points[0]
    assert calibrated_model(calibration(), moving()).rule == "gauss"


def test_noise_of_frames_and_of_means():
    framed, means = (floor_of(d, None, np.random.default_rng(0)) for d in (moving(), still()))
    assert framed.frame_from == "hold frames" and framed.frame_counts == pytest.approx(1.0, rel=0.12)
    assert framed.mean_counts == pytest.approx(1.04 / np.sqrt(12), rel=0.12)
    assert means.frame_counts == pytest.approx(1.0, rel=0.2)
    assert means.mean_counts == pytest.approx(1.04 / np.sqrt(12), rel=0.35)


def raised(counts: float, least: int) -> Dataset:
    """The dataset with another level at rest, of a converter that begins there."""
    data = moving()
    sensor = replace(data.meta.sensor, value_min=least, value_max=4095)
    presses = replace(data.presses, counts=data.presses.counts + counts)
    frames = replace(data.frames, counts=data.frames.counts + counts)
    return replace(data, meta=replace(data.meta, sensor=sensor), presses=presses, frames=frames)


@pytest.mark.parametrize("least", [0, 20])
def test_a_level_at_rest_is_high_whether_the_converter_begins_there_or_not(least: int):
    data = raised(20.0, least)
    level = high_rest(data, assumed_floor(readout_of(data)), readout_of(data))
    # Clipped at 0 before, its noise lifts it: by itself, or because the converter begins at 20.
    assert level is not None
    assert np.median(level) == pytest.approx(20.0 if least else 20.4, abs=0.1)
    assert np.abs(level - np.median(level)).max() < 1.0
    low = raised(0.0, 0)
    assert high_rest(low, assumed_floor(readout_of(low)), readout_of(low)) is None


def test_a_taxel_stuck_beyond_what_an_offset_can_be_does_not_end_the_diagnosis():
    data = raised(20.0, 0)
    stuck = np.arange(16) == 3
    frames = replace(data.frames, counts=np.where(stuck, 1e5, data.frames.counts))
    presses = replace(data.presses, counts=np.where(stuck, 1e5, data.presses.counts))
    data = replace(data, frames=frames, presses=presses)
    level = high_rest(data, assumed_floor(readout_of(data)), readout_of(data))
    offset = EFFECTS["taxel_offset"].parameters[0]
    assert level is not None and level[3] == offset.high
