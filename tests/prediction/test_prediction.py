"""A predicted dataset holds what the skin says of every press and frame, and can be read again."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from calibrations import make_calibration

from skincal.calibration import Calibration, Loss, ModelParameters, Provenance
from skincal.dataset import (
    Dataset,
    IndenterSpec,
    PositionSpec,
    Presses,
    SensorSpec,
    SurfaceSpec,
    read_dataset,
    write_dataset,
)
from skincal.errors import InputError
from skincal.model import Contacts, Sphere
from skincal.prediction import predict_dataset

Session = Callable[..., Dataset]


def by_hand(
    calibration: Calibration, dataset: Dataset, points: np.ndarray, force: np.ndarray, radius: float = 0.006
) -> np.ndarray:
    """Compute the skin's values contact by contact."""
    skin, surface = calibration.skin(), dataset.surface()
    rows = []
    for point, f in zip(points, force, strict=True):
        at = surface.project(point[None])
        rows.append(skin.values(Sphere(radius), Contacts(at, surface.normal_at(at), np.array([f])))[0])
    return np.clip(rows, 0.0, 255.0)


def sessions_own(
    calibration: Calibration, dataset: Dataset, slack_m: np.ndarray, noise: float = 0.0, seed: int = 0
) -> Dataset:
    """The dataset as this skin would have measured it, with contacts off by a slack; 25 frames a hold, as counts."""
    generator = np.random.default_rng(seed)
    presses = dataset.presses
    points = dataset.surface().offset(presses.position_m, slack_m[:, 0], slack_m[:, 1])
    values = by_hand(calibration, dataset, points, presses.force_n)
    if noise:
        frames = np.rint(values + generator.normal(0.0, noise, (25, *values.shape)))
        values = np.clip(frames, 0, 255).mean(axis=0)
    return replace(dataset, presses=replace(presses, counts=values), frames=None)


@pytest.fixture
def calibration() -> Calibration:
    return make_calibration()


def test_presses_as_the_skin_has_them(session: Session, calibration: Calibration) -> None:
    dataset = session(8)
    prediction = predict_dataset(calibration, dataset)
    presses = prediction.dataset.presses
    expected = by_hand(calibration, dataset, dataset.presses.position_m, dataset.presses.force_n)
    np.testing.assert_allclose(presses.counts, expected, atol=1e-9)
    assert (presses.counts != np.rint(presses.counts)).any(), "not rounded"
    np.testing.assert_array_equal(presses.position_m, dataset.presses.position_m)
    np.testing.assert_array_equal(presses.force_n, dataset.presses.force_n)
    assert set(presses.columns) == set(dataset.presses.columns)
    difference = presses.counts - dataset.presses.counts
    assert prediction.presses.rmse_counts == pytest.approx(np.sqrt(np.mean(difference**2)))
    assert prediction.slack_m is None


def test_frames_have_their_own_force_and_place(session: Session, calibration: Calibration) -> None:
    dataset = session(4)
    frames = dataset.frames
    assert frames is not None
    contact = frames.press >= 0
    moving = frames.position_m.copy()
    moving[contact, 1] += np.linspace(-1e-3, 1e-3, contact.sum())
    dataset = replace(dataset, frames=replace(frames, position_m=moving))
    prediction = predict_dataset(calibration, dataset)
    predicted = prediction.dataset.frames
    assert predicted is not None
    assert not predicted.counts[~contact].any(), "idle is no load"
    expected = by_hand(calibration, dataset, moving[contact], frames.force_n[contact])
    np.testing.assert_allclose(predicted.counts[contact], expected, atol=1e-9)
    np.testing.assert_array_equal(predicted.position_m, moving)
    np.testing.assert_array_equal(predicted.time_s, frames.time_s)
    assert prediction.frames is not None
    difference = (predicted.counts - frames.counts)[contact]
    assert prediction.frames.rmse_counts == pytest.approx(np.sqrt(np.mean(difference**2)))


def test_an_idle_frame_with_a_force_is_still_at_rest(session: Session, calibration: Calibration) -> None:
    dataset = session(4)
    assert dataset.frames is not None
    force = np.where(dataset.frames.phase == 0, 0.3, dataset.frames.force_n)
    dataset = replace(dataset, frames=replace(dataset.frames, force_n=force))
    predicted = predict_dataset(calibration, dataset).dataset.frames
    assert predicted is not None
    assert not predicted.counts[dataset.frames.phase == 0].any()


def test_every_press_has_its_own_indenter(session: Session, calibration: Calibration) -> None:
    dataset = session(4)
    radii = np.array([0.004, np.nan, 0.006, 0.009])
    columns = {**dataset.presses.columns, "indenter_radius_m": radii}
    dataset = replace(dataset, presses=replace(dataset.presses, columns=columns))
    predicted = predict_dataset(calibration, dataset).dataset
    for k, radius in enumerate((0.004, 0.006, 0.006, 0.009)):
        at, force = dataset.presses.position_m[k : k + 1], dataset.presses.force_n[k : k + 1]
        expected = by_hand(calibration, dataset, at, force, radius)
        np.testing.assert_allclose(predicted.presses.counts[k : k + 1], expected, atol=1e-9)
        assert dataset.frames is not None and predicted.frames is not None
        hold = (dataset.frames.press == k) & (dataset.frames.force_n == dataset.presses.force_n[k])
        np.testing.assert_allclose(
            predicted.frames.counts[hold], np.repeat(expected, hold.sum(), axis=0), atol=1e-9
        )


def test_the_indenter_of_a_frame_goes_first(session: Session, calibration: Calibration) -> None:
    dataset = session(3)
    frames = dataset.frames
    assert frames is not None
    own = np.full(len(frames), np.nan)
    own[frames.press == 1] = 0.003
    changed = replace(dataset, frames=replace(frames, columns={"indenter_radius_m": own}))
    one, other = (predict_dataset(calibration, d).dataset.frames for d in (dataset, changed))
    assert one is not None and other is not None
    different = (one.counts != other.counts).any(axis=1)
    assert different.any()
    assert set(frames.press[different]) == {1}


def test_a_measured_normal_is_used(session: Session, calibration: Calibration) -> None:
    dataset = session(4, frames_per_press=0)
    surface = dataset.surface()
    own = surface.normal_at(dataset.presses.position_m)
    tilted = own + np.array([0.15, 0.1, 0.0])
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    tilted[0] = np.nan
    # Files have few digits: lengths are 1 only nearly.
    changed = replace(dataset, presses=replace(dataset.presses, normals=1.004 * tilted))
    plain, with_normals = (predict_dataset(calibration, d).dataset.presses for d in (dataset, changed))
    np.testing.assert_allclose(with_normals.counts[0], plain.counts[0])
    skin = calibration.skin()
    at = surface.project(dataset.presses.position_m[1:])
    expected = skin.values(Sphere(0.006), Contacts(at, tilted[1:], dataset.presses.force_n[1:]))
    np.testing.assert_allclose(with_normals.counts[1:], np.clip(expected, 0, 255), atol=1e-9)
    assert np.abs(with_normals.counts[1:] - plain.counts[1:]).max() > 0.5


def test_slack_finds_where_the_presses_were(session: Session, calibration: Calibration) -> None:
    dataset = session(14)
    slack = np.random.default_rng(5).uniform(-0.8e-3, 0.8e-3, (14, 2))
    measured = sessions_own(calibration, dataset, slack, noise=1.0)
    off = predict_dataset(calibration, measured)
    prediction = predict_dataset(calibration, measured, slack=True)
    assert prediction.slack_m is not None
    assert np.abs(prediction.slack_m).max() <= 0.002
    assert prediction.presses.rmse_with_rest_counts < 0.16 < 1.0 < off.presses.rmse_with_rest_counts
    assert 0.25 < prediction.presses.rmse_counts < 0.5, "untouched taxels read 0.4 counts, the model 0"
    moved = measured.surface().offset(measured.presses.position_m, *prediction.slack_m.T)
    np.testing.assert_allclose(prediction.dataset.presses.position_m, moved, atol=1e-9)
    again = predict_dataset(calibration, prediction.dataset)
    np.testing.assert_allclose(again.dataset.presses.counts, prediction.dataset.presses.counts, atol=1e-6)
    sure = (measured.presses.counts > 4).sum(axis=1) >= 3
    np.testing.assert_allclose(prediction.slack_m[sure], slack[sure], atol=0.15e-3)


def test_frames_move_with_their_press(session: Session, calibration: Calibration) -> None:
    dataset = session(6)
    own = sessions_own(calibration, dataset, np.full((6, 2), 0.5e-3))
    measured = replace(own, frames=dataset.frames)
    prediction = predict_dataset(calibration, measured, slack=True)
    frames, presses = prediction.dataset.frames, prediction.dataset.presses
    assert frames is not None and dataset.frames is not None
    contact = frames.press >= 0
    np.testing.assert_allclose(
        frames.position_m[contact], presses.position_m[frames.press[contact]], atol=1e-9
    )
    assert np.isnan(frames.position_m[~contact]).all()
    hold = contact & (dataset.frames.force_n == presses.force_n[np.maximum(frames.press, 0)])
    np.testing.assert_allclose(frames.counts[hold], presses.counts[frames.press[hold]], atol=1e-6)


def test_values_stay_within_the_converter(session: Session) -> None:
    loud = make_calibration(model=ModelParameters(0.0235, -3.0, 5.1e8, 6800.0, beta_deg=2.1))
    dataset = session(6)
    counts = predict_dataset(loud, dataset).dataset.presses.counts
    assert counts.max() == 255.0
    meta = replace(dataset.meta, sensor=replace(dataset.meta.sensor, value_max=None))
    assert predict_dataset(loud, replace(dataset, meta=meta)).dataset.presses.counts.max() > 1000


def test_the_scale_of_each_taxel_counts(session: Session) -> None:
    dataset = session(6, frames_per_press=0)
    model = make_calibration().model
    scales = tuple(np.linspace(40.0, 90.0, 16))
    plain = predict_dataset(make_calibration(), dataset).dataset.presses.counts
    own = make_calibration(model=replace(model, scale_per_taxel_per_n=scales))
    got = predict_dataset(own, dataset).dataset.presses.counts
    np.testing.assert_allclose(got, plain * np.array(scales) / model.scale_per_n, atol=1e-9)


def test_it_can_be_written_and_read(session: Session, calibration: Calibration, tmp_path: Path) -> None:
    dataset = session(6)
    predicted = predict_dataset(calibration, dataset, slack=True).dataset
    assert predicted.meta.sensor.integer is False
    assert predicted.meta.mount == dataset.meta.mount
    assert "predicted by a calibration (fitted to paper abababababab)" in predicted.meta.source
    assert "within their slack" in predicted.meta.source
    assert predicted.meta.source.endswith("of: made for a test")
    write_dataset(predicted, tmp_path / "predicted")
    copy = read_dataset(tmp_path / "predicted")
    np.testing.assert_array_equal(copy.presses.counts, predicted.presses.counts)
    assert copy.frames is not None and predicted.frames is not None
    np.testing.assert_array_equal(copy.frames.counts, predicted.frames.counts)


def test_dead_taxels_are_predicted_and_not_compared(session: Session, calibration: Calibration) -> None:
    dataset = session(8, frames_per_press=0)
    counts = dataset.presses.counts.copy()
    counts[:, 6] = np.nan
    dead = replace(dataset, presses=replace(dataset.presses, counts=counts))
    for slack in (False, True):
        prediction = predict_dataset(calibration, dead, slack=slack)
        assert np.isfinite(prediction.dataset.presses.counts).all()
        assert np.isfinite(prediction.presses.rmse_counts)


def unplaced(dataset: Dataset, **indenter: Any) -> Dataset:
    nowhere = np.full_like(dataset.presses.position_m, np.nan)
    meta = replace(
        dataset.meta, position=PositionSpec(np.inf, np.inf), indenter=IndenterSpec(**indenter),
        surface=SurfaceSpec("plane"),
    )  # fmt: skip
    return replace(dataset, meta=meta, presses=replace(dataset.presses, position_m=nowhere), frames=None)


def test_pressure_whose_place_is_not_known(session: Session) -> None:
    """A chamber, say: a flat punch larger than the patch loads all taxels alike, wherever it is."""
    dataset = unplaced(session(5), kind="flat", radius_m=0.1)
    plane = make_calibration(
        surface=SurfaceSpec("plane"), mount=None, model=ModelParameters(0.0235, -3.0, 5.1e8, 68.0, x_m=0.001),
        intervals={},
    )  # fmt: skip
    for slack in (False, True):
        prediction = predict_dataset(plane, dataset, slack=slack)
        counts = prediction.dataset.presses.counts
        assert (counts > 0).all()
        np.testing.assert_allclose(counts, counts[:, :1] * np.ones(16), rtol=1e-6)
        assert np.isnan(prediction.dataset.presses.position_m).all()


def test_a_press_without_force_is_at_rest(session: Session, calibration: Calibration) -> None:
    dataset = session(4, frames_per_press=0)
    force = dataset.presses.force_n * np.array([1, 0, -1, 1])
    changed = replace(dataset, presses=replace(dataset.presses, force_n=force))
    prediction = predict_dataset(calibration, changed, slack=True)
    assert prediction.slack_m is not None
    assert not prediction.dataset.presses.counts[[1, 2]].any()
    assert not prediction.slack_m[[1, 2]].any()
    assert prediction.slack_m[[0, 3]].any()


def test_meshes_press_and_carry_too(session: Session) -> None:
    """An indenter and a fingertip of triangles: slightly rough copies of the sphere and the cylinder."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.006)
    ball.apply_translation([0.0, 0.0, 0.006])
    content = ball.export(file_type="stl")
    dataset = session(4, frames_per_press=0)
    calibration = make_calibration()
    sphere = predict_dataset(calibration, dataset, slack=True)
    meta = replace(dataset.meta, indenter=IndenterSpec("mesh", file="ball.stl"))
    of_mesh = predict_dataset(
        calibration, replace(dataset, meta=meta, meshes={"ball.stl": content}), slack=True
    )
    assert sphere.slack_m is not None and of_mesh.slack_m is not None
    np.testing.assert_allclose(of_mesh.presses.rmse_counts, sphere.presses.rmse_counts, rtol=0.1)
    np.testing.assert_allclose(
        of_mesh.dataset.presses.counts,
        sphere.dataset.presses.counts,
        atol=0.1 * sphere.dataset.presses.counts.max(),
    )


def test_another_sensor_is_refused_with_everything_that_differs(
    session: Session, calibration: Calibration
) -> None:
    dataset = session(4)
    counts = dataset.presses.counts[:, :12]
    sensor = SensorSpec(3, 4, (0.0025, 0.0025), (0.004, 0.004), value_min=0, value_max=255)
    meta = replace(dataset.meta, sensor=sensor, surface=SurfaceSpec("cylinder", 0.01))
    other = replace(dataset, meta=meta, presses=replace(dataset.presses, counts=counts), frames=None)
    with pytest.raises(InputError) as caught:
        predict_dataset(calibration, other)
    size, radius = caught.value.problems
    assert size.expected.startswith("4 x 4 taxels")
    assert size.got == "3 x 4"
    assert "radius_m" in radius.place
    assert (radius.expected, radius.got) == ("0.0115 m, as calibrated", "0.01 m")


def test_a_sensor_of_another_mount_is_refused(session: Session, calibration: Calibration) -> None:
    dataset = session(4)
    pose = calibration.model
    assert pose.beta_deg is not None
    intervals = {"y_m": (pose.y_m, pose.y_m + 1e-4), "alpha_deg": (pose.alpha_deg - 1, pose.alpha_deg + 1)}
    calibration = replace(calibration, intervals=intervals)
    slack = dataset.meta.position.slack_m
    mount = replace(
        dataset.meta.mount,
        y_range_m=(pose.y_m - 5e-3, pose.y_m - 1.1 * slack),
        beta_range_deg=(pose.beta_deg + 0.5 * np.degrees(slack / 0.0115), pose.beta_deg + 20),
        alpha_range_deg=(pose.alpha_deg + 1.5, pose.alpha_deg + 20),
    )
    other = replace(dataset, meta=replace(dataset.meta, mount=mount))
    with pytest.raises(InputError) as caught:
        predict_dataset(calibration, other)
    along, turn = caught.value.problems
    assert "[mount] y_range_m" in along.place and "[mount] alpha_range_deg" in turn.place
    assert "calibrated alpha_deg" in turn.expected
    # Whoever searched beyond the ranges has found it in these data.
    same = replace(calibration, provenance=replace(calibration.provenance, dataset_sha256="ef" * 32))
    predict_dataset(same, replace(other, sha256="ef" * 32))
    free = replace(other.meta, position=replace(other.meta.position, slack_m=np.inf))
    predict_dataset(calibration, replace(other, meta=free))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"sensor": SensorSpec(4, 4, (0.0025, 0.0025), (0.005, 0.005))}, "taxels up to 1.5 mm off"),
        ({"surface": SurfaceSpec("plane")}, '"plane"'),
        ({"sensor": SensorSpec(4, 4, (0.0025, 0.0025), (0.004, 0.004), value_max=1023)}, "1023"),
    ],
)
def test_another_layout_or_surface_is_refused(
    session: Session, calibration: Calibration, change: dict[str, Any], word: str
) -> None:
    dataset = session(4)
    with pytest.raises(InputError, match="calibration") as caught:
        predict_dataset(calibration, replace(dataset, meta=replace(dataset.meta, **change)))
    (problem,) = caught.value.problems
    assert problem.got == word
    assert problem.fix


def test_progress_is_reported(session: Session, calibration: Calibration) -> None:
    told: list[tuple[str, int, int]] = []
    predict_dataset(calibration, session(4), slack=True, progress=lambda *step: told.append(step))
    assert [stage for stage, done, of in told if done == of] == ["slack", "presses", "frames"]


def truth_of(shared: Path, name: str) -> tuple[Dataset, Calibration, dict[str, float]]:
    """A practice session and its true skin, as its positions tell it."""
    dataset = read_dataset(shared / "practice" / name)
    labels = json.loads((shared / "practice" / "labels.json").read_text())[name]
    values = labels["truth"] | labels["truth_as_the_positions_tell_it"]
    model = ModelParameters(**values)
    calibration = Calibration.of_dataset(
        dataset, model=model, intervals={}, loss=Loss(0.0, 0.0, 0), provenance=Provenance("", name)
    )
    return dataset, calibration, labels["noise_floor_rmse_counts"]


def test_the_truth_predicts_a_practice_session_down_to_its_noise(shared: Path) -> None:
    dataset, calibration, floor = truth_of(shared, "fit-2")
    measured = predict_dataset(calibration, dataset)
    moved = predict_dataset(calibration, dataset, slack=True)
    assert measured.presses.rmse_with_rest_counts > 10 * moved.presses.rmse_with_rest_counts
    assert moved.presses.rmse_with_rest_counts < 1.1 * floor["hold_mean_rmse"]


def test_the_truth_predicts_the_frames_of_a_practice_session(shared: Path) -> None:
    dataset, calibration, floor = truth_of(shared, "gap-06")
    moved = predict_dataset(calibration, dataset, slack=True)
    assert moved.frames is not None
    assert moved.frames.rmse_with_rest_counts < 1.05 * floor["frame_rmse"]


def test_presses_need_no_order(session: Session, calibration: Calibration) -> None:
    """Frames find their press by its number, wherever it stands in the table."""
    dataset = session(5)
    turned = replace(dataset, presses=dataset.presses.select(np.array([3, 1, 4, 0, 2])))
    assert isinstance(turned.presses, Presses)
    columns = {"indenter_radius_m": 0.004 + 0.001 * turned.presses.press}
    turned = replace(turned, presses=replace(turned.presses, columns=columns))
    straight = {"indenter_radius_m": 0.004 + 0.001 * dataset.presses.press}
    dataset = replace(dataset, presses=replace(dataset.presses, columns=straight))
    one, other = (predict_dataset(calibration, d).dataset.frames for d in (dataset, turned))
    assert one is not None and other is not None
    np.testing.assert_allclose(one.counts, other.counts)
