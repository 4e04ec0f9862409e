"""The level at rest, active taxels, the summary, and places on the patch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from skincal.dataset import Dataset, active_taxels, rest_levels
from skincal.dataset.dataset import session_times_s
from skincal.dataset.placement import patch_coordinates
from skincal.dataset.rest import summarise
from skincal.model import Cylinder, MeshSurface, Plane, SensorPose
from tests.dataset.changes import with_presses, with_sensor

Session = Callable[..., Dataset]


def test_rest_comes_from_idle_frames(session: Session) -> None:
    dataset = session(12)
    frames = dataset.frames
    assert frames is not None
    level = np.arange(16.0)
    raised = replace(dataset, frames=replace(frames, counts=frames.counts + level))
    np.testing.assert_array_equal(rest_levels(raised), level)


def test_rest_without_frames_is_what_untouched_taxels_read(session: Session) -> None:
    dataset = session(40, frames_per_press=0)
    raised = with_presses(dataset, counts=dataset.presses.counts + 12.0)
    np.testing.assert_allclose(rest_levels(raised), 12.4, atol=0.5)
    np.testing.assert_array_equal(active_taxels(raised), active_taxels(dataset))


def test_rest_that_was_taken_off_is_zero(session: Session) -> None:
    dataset = with_sensor(session(40, frames_per_press=0), baseline="subtracted")
    np.testing.assert_array_equal(rest_levels(dataset), np.zeros(16))


def test_dead_and_stuck_taxels_never_answer(session: Session) -> None:
    dataset = session(40, frames_per_press=0)
    counts = dataset.presses.counts.copy()
    counts[:, 0], counts[:, 1] = np.nan, 255.0
    changed = with_presses(dataset, counts=counts)
    active, summary = active_taxels(changed), summarise(changed)
    assert not active[:, :2].any()
    assert active[:, 2:].any()
    assert summary.dead == ("taxel_0_0",)
    assert "taxel_0_1" in summary.silent


def test_a_higher_threshold_lets_fewer_answer(session: Session) -> None:
    dataset = session(40)
    low, high = active_taxels(dataset, 1.0), active_taxels(dataset, 20.0)
    assert (low | ~high).all()
    assert low.sum() > high.sum()


def test_the_summary_counts(session: Session) -> None:
    dataset = session(12)
    summary = summarise(dataset)
    assert summary.presses == 12
    assert summary.frames == sum(summary.phases.values()) == 96
    assert sum(summary.active) == 12
    assert summary.usable == int(np.sum(active_taxels(dataset).sum(axis=1) >= 2))
    assert summary.labels["pose"] == {"A": 6, "B": 6}
    assert summary.force_n[0] == dataset.presses.force_n.min()
    assert summary.session_s == pytest.approx(5.0 * 11 + 5.0)
    assert summary.sites is None
    times = session_times_s(dataset)
    assert times is not None
    assert times[0] == 5.0


POSES = st.builds(
    SensorPose,
    y_m=st.floats(-0.01, 0.03),
    alpha_rad=st.floats(-3.0, 3.0),
    beta_rad=st.floats(-3.0, 3.0),
    x_m=st.floats(-0.01, 0.01),
)


@given(pose=POSES, seed=st.integers(0, 100))
def test_the_way_back_from_the_surface_is_exact(pose: SensorPose, seed: int) -> None:
    uv = np.random.default_rng(seed).uniform(-0.012, 0.012, (8, 2))
    for surface in (Cylinder(0.0115), Plane()):
        points, _ = surface.wrap(pose, uv)
        np.testing.assert_allclose(patch_coordinates(surface, pose, points), uv, atol=1e-12)


def test_points_off_the_cylinder_and_unknown_ones() -> None:
    pose = SensorPose(0.02, 0.0)
    points = np.array([[0.0, 0.021, 0.5], [np.nan] * 3])
    uv = patch_coordinates(Cylinder(0.0115), pose, points)
    np.testing.assert_allclose(uv[0], [0.0, 0.001])
    assert np.isnan(uv[1]).all()


def test_the_way_back_from_a_mesh() -> None:
    tip = trimesh.creation.cylinder(radius=0.0115, height=0.08, sections=180)
    tip.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    pose = SensorPose(0.005, 0.3, beta_rad=0.2)
    uv = np.random.default_rng(0).uniform(-0.007, 0.007, (20, 2))
    points, _ = Cylinder(0.0115).wrap(pose, uv)
    points = np.vstack([points, [[np.nan] * 3]])
    found = patch_coordinates(MeshSurface(tip.vertices, tip.faces), pose, points, 0.01)
    np.testing.assert_allclose(found[:-1], uv, atol=5e-5)
    assert np.isnan(found[-1]).all()
