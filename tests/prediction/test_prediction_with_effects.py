"""A prediction has the calibration's effects: frames in the order of time, presses from their holds, or played ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
from calibrations import make_calibration

from skincal.calibration import Calibration, Effect, effect_from, skin_of, stream_of
from skincal.dataset import Dataset, IndenterSpec
from skincal.diagnosis.dataset_session import gap_session
from skincal.effects import EFFECTS, Samples, hold_session, hold_times
from skincal.model import Contacts, Sphere
from skincal.prediction import predict_dataset
from skincal.prediction.touches import frame_normals, frame_presses

Session = Callable[..., Dataset]
POSES = ("A", "B")


def rich(dataset: Dataset, seed: int = 0) -> Dataset:
    """The session with every covariate that an effect may ask for."""
    rng, count = np.random.default_rng(seed), len(dataset.presses)
    columns = {
        **dataset.presses.columns,
        "speed_m_per_s": rng.choice([3e-4, 3e-3], count),
        "cycle": rng.integers(0, 3, count).astype(float),
        "temperature_c": 25 + rng.normal(0.0, 3.0, count),
        "shear_u_n": rng.normal(0.0, 0.5, count),
        "shear_v_n": rng.normal(0.0, 0.5, count),
    }
    return replace(dataset, presses=replace(dataset.presses, columns=columns))


def calibrated(*effects: Effect) -> Calibration:
    return make_calibration(effects=effects)


def case_of(name: str) -> Effect:
    given = EFFECTS[name].at_strength(1.0, np.random.default_rng(4), make_calibration().layout())
    return effect_from(name, given, taxels=16, poses=POSES)


def covariates(dataset: Dataset, press: int) -> dict[str, Any]:
    columns = dataset.presses.columns
    names = ("speed_m_per_s", "cycle", "temperature_c", "shear_u_n", "shear_v_n")
    return {
        "pose": POSES.index(str(columns["pose"][press])),
        **{name: columns[name][press] for name in names},
    }


def one_by_one(calibration: Calibration, dataset: Dataset) -> np.ndarray:
    """Frames as a simulated sensor would give them, sample by sample."""
    stream, surface, frames = stream_of(calibration), dataset.surface(), dataset.frames
    assert frames is not None
    rows, last = [], 0
    for k in range(len(frames)):
        touching = frames.press[k] >= 0
        last = int(frames.press[k]) if touching else last
        at = surface.project(frames.position_m[k : k + 1]) if touching else np.full((1, 3), np.nan)
        normal = surface.normal_at(at) if touching else np.array([[0.0, 0.0, 1.0]])
        sample = Samples.of(
            Contacts(at, normal, np.array([frames.force_n[k] if touching else 0.0])),
            Sphere(0.006),
            touching=touching,
            press=frames.press[k],
            time_s=frames.time_s[k],
            phase=int(frames.phase[k]),
            **covariates(dataset, last),
        )
        rows.append(stream.step(sample)[0])
    return np.clip(rows, 0.0, 255.0)


@pytest.mark.parametrize("name", EFFECTS)
def test_presses_are_the_means_of_their_hold_frames(session: Session, name: str) -> None:
    dataset = rich(session(3))
    calibration = calibrated(case_of(name))
    prediction = predict_dataset(calibration, dataset)
    frames, measured = prediction.dataset.frames, dataset.frames
    assert frames is not None and measured is not None
    np.testing.assert_allclose(frames.counts, one_by_one(calibration, dataset), atol=1e-9)
    for k in range(3):
        hold = (measured.press == k) & (measured.phase == 2)
        np.testing.assert_allclose(prediction.dataset.presses.counts[k], frames.counts[hold].mean(axis=0))
    assert not prediction.warnings
    plain = predict_dataset(make_calibration(), dataset).dataset.frames
    assert plain is not None
    assert np.abs(frames.counts - plain.counts).max() > 0.3


def test_neutral_effects_change_nothing(session: Session) -> None:
    dataset = session(3)
    neutral = predict_dataset(calibrated(*(Effect(name) for name in EFFECTS)), dataset)
    base = predict_dataset(make_calibration(), dataset)
    np.testing.assert_array_equal(neutral.dataset.presses.counts, base.dataset.presses.counts)
    assert neutral.dataset.frames is not None and base.dataset.frames is not None
    np.testing.assert_array_equal(neutral.dataset.frames.counts, base.dataset.frames.counts)
    assert "effects" not in neutral.dataset.meta.source


@pytest.mark.parametrize("name", ["creep", "hysteresis", "gain_drift", "spread", "force_bias"])
def test_without_frames_each_press_is_played_for_itself(session: Session, name: str) -> None:
    dataset = rich(session(4, frames_per_press=0))
    calibration = calibrated(case_of(name))
    predicted = predict_dataset(calibration, dataset).dataset.presses
    skin, surface, presses = skin_of(calibration), dataset.surface(), dataset.presses
    start = presses.columns["t_start_s"]
    for k in range(4):
        times = [[presses.columns[n][k]] for n in ("t_start_s", "t_hold_s", "t_release_s", "t_end_s")]
        at = surface.project(presses.position_m[k : k + 1])
        hold = Samples.of(
            Contacts(at, surface.normal_at(at), presses.force_n[k : k + 1]),
            Sphere(0.006),
            **covariates(dataset, k),
        )
        played = hold_session(hold, hold_times(1, *times))
        first = float(start[0]) + (presses.columns["t_hold_s"][0] - float(start[0])) / 12
        samples = replace(played.samples, start_s=first)
        np.testing.assert_allclose(predicted.counts[k], played.means(skin.values(samples))[0], atol=1e-9)


def test_the_order_of_the_table_does_not_matter(session: Session) -> None:
    dataset, order = rich(session(5, frames_per_press=0)), np.array([3, 1, 4, 0, 2])
    turned = replace(dataset, presses=dataset.presses.select(order))
    calibration = calibrated(case_of("gain_drift"), case_of("creep"))
    for slack in (False, True):
        one, other = (predict_dataset(calibration, d, slack=slack).dataset.presses for d in (dataset, turned))
        np.testing.assert_allclose(other.counts, one.counts[order], atol=1e-6)


def test_a_hold_from_above_differs_under_hysteresis(session: Session) -> None:
    dataset = session(2, frames_per_press=0)
    branch = {**dataset.presses.columns, "branch": np.array(["up", "down"], dtype=object)}
    places = dataset.presses.position_m[[0, 0]]
    presses = replace(dataset.presses, columns=branch, position_m=places, force_n=np.array([2.0, 2.0]))
    same = replace(dataset, presses=presses)
    up, down = predict_dataset(calibrated(case_of("hysteresis")), same).dataset.presses.counts
    assert down.max() > 1.05 * up.max()


def test_a_covariate_that_is_empty_in_some_presses_is_said(session: Session) -> None:
    dataset = rich(session(5, frames_per_press=0))
    columns = dict(dataset.presses.columns)
    columns["temperature_c"] = np.where(np.arange(5) < 2, columns["temperature_c"], np.nan)
    part = replace(dataset, presses=replace(dataset.presses, columns=columns))
    warm = Effect("gain_drift", {"temperature_per_k": 0.1})
    slow = Effect("gain_drift", {"rate_per_s": 1e-4})
    for effect, said in ((warm, 1), (slow, 0), (case_of("crosstalk"), 0)):
        warnings = predict_dataset(calibrated(effect), part).warnings
        found = [str(w) for w in warnings if "temperature_c" in w.place]
        assert len(found) == said
        assert all("empty in 3 of 5 presses" in text and "gain_drift" in text for text in found)
    assert predict_dataset(calibrated(warm), dataset).warnings == ()


@pytest.mark.parametrize("targets", [True, False])
@pytest.mark.parametrize("frames", [8, 0])
def test_what_a_site_has_met_is_read_off_its_earlier_presses(
    session: Session, targets: bool, frames: int
) -> None:
    dataset = session(4, frames_per_press=frames)
    presses, site = dataset.presses, np.array([0, 1, 0, 0])
    force, cycle = np.array([1.5, 4.0, 0.8, 2.0]), np.array([0.0, 0.0, 1.0, 2.0])
    places, columns = presses.position_m[site], {**presses.columns, "cycle": cycle}
    if targets:
        # Where presses were meant to be counts, not where they are.
        columns |= dict(zip(("target_x_m", "target_y_m", "target_z_m"), places.T, strict=True))
        places = presses.position_m[[1, 0, 1, 1]]
    dataset = replace(dataset, presses=replace(presses, columns=columns, force_n=force, position_m=places))
    given = {"amplitude": 0.5, "cycles": 100.0, "fading_per_n": 0.7}
    skin = make_calibration()
    # An effect next to nothing, so that presses of both are those of their frames.
    fading, plain = (
        predict_dataset(replace(skin, effects=(Effect("first_cycle", one),)), dataset).dataset.presses.counts
        for one in (given, given | {"amplitude": 1e-12})
    )
    met = np.array([0.0, 0.0, 1.5, 1.5])
    expected = 1 + 0.5 * np.exp(-cycle / 100 - 0.7 * met)
    lit = plain.argmax(axis=1)
    rows = np.arange(4)
    np.testing.assert_allclose(fading[rows, lit] / plain[rows, lit], expected, rtol=1e-9)
    uncounted = replace(dataset, presses=replace(dataset.presses, columns=presses.columns))
    (warning,) = predict_dataset(replace(skin, effects=(Effect("first_cycle", given),)), uncounted).warnings
    assert "first_cycle: expected cycle; got none" in str(warning)


def test_what_lacks_a_covariate_is_left_out_and_said(session: Session) -> None:
    dataset = session(3)
    base = predict_dataset(make_calibration(), dataset)
    lacking = predict_dataset(calibrated(case_of("rate")), dataset)
    assert lacking.abstaining == {"rate": ("speed",)}
    (warning,) = lacking.warnings
    assert str(warning) == (
        "the dataset, for the effect rate: expected speed_m_per_s; got none. The prediction leaves it out."
    )
    assert lacking.dataset.frames is not None and base.dataset.frames is not None
    np.testing.assert_array_equal(lacking.dataset.frames.counts, base.dataset.frames.counts)


def test_without_a_clock_only_what_needs_none_is_there(session: Session) -> None:
    dataset = session(3, frames_per_press=0)
    untimed = replace(dataset, presses=replace(dataset.presses, columns={}))
    both = predict_dataset(calibrated(case_of("creep"), case_of("crosstalk")), untimed)
    only = predict_dataset(calibrated(case_of("crosstalk")), untimed)
    np.testing.assert_array_equal(both.dataset.presses.counts, only.dataset.presses.counts)
    assert both.abstaining == {"creep": ("time",)}
    assert "t_start_s, t_hold_s, t_release_s, t_end_s of every press" in str(both.warnings[0])
    assert not only.warnings


def test_drift_without_frames_counts_from_session_start(session: Session) -> None:
    data, drifting = session(6), calibrated(Effect("baseline_drift", {"slope_counts_per_s": 0.05}))
    last = int(data.presses.press[-1])
    fewer = replace(data, frames=data.frames.select(data.frames.press != last))
    whole, part = (predict_dataset(drifting, one).dataset.presses.counts[-1] for one in (data, fewer))
    assert part == pytest.approx(whole, abs=0.5)


def test_frames_have_the_normals_of_their_press(session: Session) -> None:
    data = session(6)
    own = data.surface().normal_at(data.surface().project(data.presses.position_m))
    tilted = own + 0.1 * np.array([0.0, 1.0, 0.0])
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    data = replace(data, presses=replace(data.presses, normals=tilted))
    normals = frame_normals(data)
    assert normals is not None
    touching = data.frames.press >= 0
    assert normals[touching] == pytest.approx(tilted[frame_presses(data)[touching]])
    assert np.isnan(normals[~touching]).all()
    samples = gap_session(data).samples
    off = samples.contacts.normals[samples.touching] - data.surface().normal_at(
        samples.contacts.points_m[samples.touching]
    )
    assert np.abs(off[:, 1]).min() > 0.08


def test_poses_go_by_their_names(session: Session) -> None:
    dataset = session(4)
    biased = Effect("force_bias", {"pose_scale": (1.3, 0.7)}, poses=("B", "Z"))
    prediction = predict_dataset(calibrated(biased), dataset)
    base = predict_dataset(make_calibration(), dataset)
    assert prediction.dataset.frames is not None and base.dataset.frames is not None
    ours, plain = prediction.dataset.frames.counts, base.dataset.frames.counts
    in_b = (dataset.frames.press % 2 == 1) & (dataset.frames.press >= 0)  # type: ignore[union-attr]
    np.testing.assert_array_equal(ours[~in_b], plain[~in_b])
    assert ours[in_b].sum() > 1.2 * plain[in_b].sum()
    assert "expected the poses B, Z; got A" in str(prediction.warnings[0])


def test_the_radius_of_a_mesh_is_scaled_like_that_of_its_ball(session: Session) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.006).apply_translation([0.0, 0.0, 0.006])
    meta = replace(session(2).meta, indenter=IndenterSpec("mesh", file="ball.stl"))
    dataset = replace(session(2), meta=meta, meshes={"ball.stl": ball.export(file_type="stl")})
    skin = calibrated(case_of("indenter_radius"))
    meshed, plain = (predict_dataset(skin, one).dataset.presses.counts for one in (dataset, session(2)))
    assert np.nansum((meshed - plain) ** 2) < 1e-4 * np.nansum(plain**2)


@pytest.mark.parametrize(
    ("names", "frames_per_press"),
    [(("hysteresis", "creep"), 24), (("creep", "taxel_gain"), 0), (("saturation", "gain_drift"), 24)],
)
def test_slack_finds_where_presses_were_under_effects(
    session: Session, names: tuple[str, ...], frames_per_press: int
) -> None:
    dataset = rich(session(24, frames_per_press=frames_per_press))
    # Soft enough that most presses reach several taxels, which tell the place.
    soft = replace(make_calibration().model, elasticity_pa_per_m=1.5e8)
    calibration = make_calibration(model=soft, effects=tuple(map(case_of, names)))
    slack = np.random.default_rng(5).uniform(-0.8e-3, 0.8e-3, (24, 2))
    surface = dataset.surface()
    moved = replace(
        dataset.presses, position_m=surface.offset(dataset.presses.position_m, slack[:, 0], slack[:, 1])
    )
    frames = dataset.frames
    if frames is not None:
        place, touching = frames.position_m.copy(), frames.press >= 0
        place[touching] = moved.position_m[frames.press[touching]]
        frames = replace(frames, position_m=place)
    truth = predict_dataset(calibration, replace(dataset, presses=moved, frames=frames)).dataset
    presses = replace(dataset.presses, counts=truth.presses.counts)
    own = None if frames is None else replace(dataset.frames, counts=truth.frames.counts)  # type: ignore[union-attr,type-var]
    measured = replace(dataset, presses=presses, frames=own)
    prediction = predict_dataset(calibration, measured, slack=True)
    assert prediction.slack_m is not None
    sure = (measured.presses.counts > 4).sum(axis=1) >= 3
    assert sure.sum() >= 4
    np.testing.assert_allclose(prediction.slack_m[sure], slack[sure], atol=0.15e-3)
    difference = (prediction.dataset.presses.counts - measured.presses.counts)[sure]
    assert np.sqrt(np.mean(difference**2)) < 0.15


def test_levels_that_the_prediction_has_are_not_added_twice(session: Session) -> None:
    dataset = session(6)
    calibration = calibrated(Effect("taxel_offset", {"offset_counts": tuple(np.linspace(-3.0, 9.0, 16))}))
    truth = predict_dataset(calibration, dataset).dataset
    measured = replace(dataset, presses=truth.presses, frames=truth.frames)
    prediction = predict_dataset(calibration, measured)
    assert prediction.presses.rmse_counts < 1e-9
    assert prediction.presses.rmse_with_rest_counts < 0.5
