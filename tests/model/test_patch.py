from __future__ import annotations

import numpy as np
import pytest
from model_shapes import POSE, cylinder_mesh, surface_of
from published import FINGER, LAYOUT

from skincal.model import (
    Contacts,
    Cylinder,
    Patch,
    Plane,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    Surface,
    TaxelLayout,
    patch_cells,
)


def test_the_papers_patch_has_14884_points():
    patch = Patch.build(FINGER, LAYOUT, POSE)
    assert len(patch) == 14884 == 122**2
    np.testing.assert_allclose(patch.areas_m2, (0.25e-3) ** 2)
    np.testing.assert_array_equal(np.bincount(patch.taxel + 1), [14884 - 1600, *[100] * 16])
    assert patch.border.sum() == 4 * 121


def test_a_point_lies_where_the_contract_says():
    pose, radius = SensorPose(y_m=0.02, alpha_rad=0.4, beta_rad=-0.2), 0.0115
    patch = Patch.build(FINGER, LAYOUT, pose)
    uv, _ = patch_cells(patch.layout, 0.25e-3, 8e-3)
    u, v = uv.T
    beta = pose.beta_rad + (u * np.cos(0.4) - v * np.sin(0.4)) / radius
    y = pose.y_m + u * np.sin(0.4) + v * np.cos(0.4)
    np.testing.assert_allclose(
        patch.points_m, np.stack([radius * np.sin(beta), y, radius * np.cos(beta)], axis=1)
    )
    np.testing.assert_allclose(
        patch.normals, np.stack([np.sin(beta), 0 * beta, np.cos(beta)], axis=1), atol=1e-15
    )


@pytest.mark.parametrize("rule", ["midpoint", "gauss"])
@pytest.mark.parametrize("resolution_m", [0.17e-3, 0.3e-3, 0.5e-3, 2e-3])
def test_taxels_have_their_exact_area_at_any_resolution(resolution_m, rule):
    layout = TaxelLayout.grid(3, 5, taxel_size_m=(0.0023, 0.0031), pitch_m=(0.0037, 0.0041))
    pose = SensorPose(0.0, 0.2)
    patch = Patch.build(Plane(), layout, pose, resolution_m=resolution_m, margin_m=5e-3, rule=rule)
    area = np.bincount(patch.taxel + 1, patch.areas_m2)
    np.testing.assert_allclose(area[1:], 0.0023 * 0.0031, rtol=1e-12)
    extent = layout.bounds_m[1] - layout.bounds_m[0] + 2 * 5e-3
    assert patch.areas_m2.sum() == pytest.approx(extent.prod(), rel=1e-12)


@pytest.mark.parametrize("resolution_m", [0.5e-3, 0.8e-3])
def test_gauss_sums_what_is_smooth_over_a_taxel_up_exactly(resolution_m):
    # Cells of 0.5 mm are five in a taxel, an odd number; those of 0.8 mm are four.
    layout = TaxelLayout.grid(2, 2, taxel_size_m=2.5e-3, pitch_m=4e-3)
    uv, size = patch_cells(layout, resolution_m, 1e-3, "gauss")
    plain = patch_cells(layout, resolution_m, 1e-3)
    assert len(uv) == len(plain[0])
    for taxel, (low, high) in enumerate(
        zip(layout.centres_m - 1.25e-3, layout.centres_m + 1.25e-3, strict=True)
    ):
        exact = np.prod([(high[k] ** 4 - low[k] ** 4) / 4 for k in range(2)])
        found = []
        for points, sizes in ((uv, size), plain):
            own = layout.taxel_at(points) == taxel
            found.append(float((points[own] ** 3).prod(axis=1) @ sizes[own].prod(axis=1)))
        assert found[0] == pytest.approx(exact, rel=1e-10)
        assert abs(found[1] / exact - 1) > 1e-3


def test_gauss_gives_images_nearer_to_those_of_fine_cells():
    rng = np.random.default_rng(0)
    layout = TaxelLayout.grid(4, 4, taxel_size_m=2.5e-3, pitch_m=4e-3)
    surface, pose = Cylinder(11.5e-3), SensorPose(0.02, 0.1)
    uv = rng.uniform(-6e-3, 6e-3, (60, 2))
    contacts = Contacts(*surface.wrap(pose, uv), rng.uniform(0.5, 6.0, 60))

    def values(resolution_m, rule):
        patch = Patch.build(surface, layout, pose, resolution_m, 6e-3, rule)
        return Skin(patch, SkinParameters(5e8, 60.0)).values(Sphere(6e-3), contacts)

    fine = values(0.08e-3, "gauss")
    lit = fine > 5.0
    off = {rule: np.sqrt(((values(0.5e-3, rule) - fine)[lit] ** 2).mean()) for rule in ("midpoint", "gauss")}
    assert off["midpoint"] == pytest.approx(0.4, abs=0.1)
    assert off["gauss"] == pytest.approx(0.2, abs=0.05)


def test_cells_are_no_longer_than_the_resolution():
    _, size = patch_cells(TaxelLayout.grid(3, 3, taxel_size_m=0.0023, pitch_m=0.0037), 0.3e-3, 1e-3)
    assert size.max() <= 0.3e-3 * (1 + 1e-5)


def _scattered() -> TaxelLayout:
    """144 taxels of 1.5 mm, none in line with another."""
    centres = np.stack(np.meshgrid(np.arange(12), np.arange(12)), axis=-1).reshape(-1, 2) * 4e-3
    jitter = np.random.default_rng(3).uniform(-1e-3, 1e-3, centres.shape)
    return TaxelLayout(12, 12, centres + jitter, np.array([1.5e-3, 1.5e-3]))


def test_scattered_taxels_have_their_exact_area_too():
    patch = Patch.build(Plane(), _scattered(), SensorPose(0.0, 0.0), margin_m=2e-3)
    np.testing.assert_allclose(np.bincount(patch.taxel + 1, patch.areas_m2)[1:], 1.5e-3**2, rtol=1e-9)


@pytest.mark.parametrize("rule", ["midpoint", "gauss"])
def test_too_many_edges_cut_the_patch_evenly(rule):
    _, size = patch_cells(_scattered(), 0.5e-3, 2e-3, rule)
    np.testing.assert_allclose(size, np.broadcast_to(size[0], size.shape))
    assert size.max() <= 0.5e-3
    pose = SensorPose(0.0, 0.0)
    patch = Patch.build(Plane(), _scattered(), pose, resolution_m=0.5e-3, margin_m=2e-3, rule=rule)
    area = np.bincount(patch.taxel + 1, patch.areas_m2)[1:] / 1.5e-3**2
    assert np.abs(area - 1).max() < 0.8  # a row of cells more or less on each axis
    assert abs(area.mean() - 1) < 0.02


def test_no_margin_is_a_margin():
    patch = Patch.build(Plane(), LAYOUT, SensorPose(0.0, 0.0), margin_m=0.0)
    assert len(patch) == 58**2


def test_margin_beyond_the_edge_of_a_mesh_is_left_out():
    surface = surface_of(cylinder_mesh(64))
    inside = Patch.build(surface, LAYOUT, SensorPose(0.03, 0.0))
    at_end = Patch.build(surface, LAYOUT, SensorPose(0.07 - 0.01, 0.0))
    assert len(inside) == 14884
    assert 0.7 * 14884 < len(at_end) < 14884
    assert at_end.points_m[:, 1].max() <= 0.07
    # Where the skin ends early it has a border there.
    assert np.any(at_end.border & (at_end.points_m[:, 1] > 0.0695))


def test_a_taxel_beyond_the_edge_is_refused():
    with pytest.raises(ValueError, match="every taxel to lie on the surface; got"):
        Patch.build(surface_of(cylinder_mesh(64)), LAYOUT, SensorPose(0.07 - 0.005, 0.0))


def test_an_overlapping_patch_loses_its_margin():
    thin = Cylinder(0.0035)
    patch = Patch.build(thin, LAYOUT, SensorPose(0.02, 0.0))
    assert np.ptp(np.arctan2(patch.points_m[:, 0], patch.points_m[:, 2])) <= 2 * np.pi
    assert patch.areas_m2.sum() == pytest.approx(2 * np.pi * 0.0035 * 30.5e-3, rel=0.02)
    with pytest.raises(ValueError, match="wrapped around by more than half a turn"):
        Patch.build(Cylinder(0.002), LAYOUT, SensorPose(0.02, 0.0))


@pytest.mark.parametrize(
    ("resolution_m", "margin_m"), [(0.0, 8e-3), (np.nan, 8e-3), (1e-3, -1e-3), (1e-3, np.inf)]
)
def test_lengths_that_make_no_sense_are_refused(resolution_m, margin_m):
    with pytest.raises(ValueError, match="expected a finite"):
        Patch.build(Plane(), LAYOUT, SensorPose(0.0, 0.0), resolution_m, margin_m)


def test_a_pose_must_be_finite():
    with pytest.raises(ValueError, match="pose alpha_rad: expected a finite number; got nan"):
        SensorPose(0.0, float("nan"))


def _points(**changes: object) -> Patch:
    good = {
        "points_m": np.zeros((2, 3)),
        "normals": np.tile([0.0, 0.0, 1.0], (2, 1)),
        "areas_m2": np.ones(2),
        "taxel": np.array([-1, 0]),
        "layout": TaxelLayout.grid(1, 1, taxel_size_m=1e-3, pitch_m=1e-3),
    }
    return Patch(**(good | changes))


def test_points_can_be_given_as_they_are():
    patch = _points()
    assert len(patch) == 2
    assert not patch.border.any()
    with pytest.raises(ValueError, match="read-only"):
        patch.areas_m2[0] = 2.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"points_m": np.full((2, 3), np.nan)}, "patch points_m: expected finite numbers; got 6"),
        ({"normals": np.zeros((2, 3))}, "unit vectors"),
        ({"areas_m2": -np.ones(2)}, "areas >= 0"),
        ({"areas_m2": np.ones(3)}, "patch areas_m2: expected shape"),
        ({"taxel": np.array([0, 1])}, "patch taxel: expected -1 to 0; got 0 to 1"),
        ({"border": np.zeros(3, dtype=bool)}, "patch border: expected shape"),
    ],
)
def test_points_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        _points(**changes)


@pytest.mark.parametrize(
    "surface", [FINGER, Plane(), surface_of(cylinder_mesh(24))], ids=["cylinder", "plane", "mesh"]
)
def test_tiles_hold_their_points(surface: Surface):
    """Every point lies in its tile's ball and slab, once with its area; seen face on, a slab is thin."""
    patch = Patch.build(surface, LAYOUT, POSE, 0.5e-3)
    tiled = patch.tiled
    away = tiled.points[:3].reshape(3, tiled.tiles.shape[1], -1) - tiled.tiles[:3, :, None]
    assert np.all(np.linalg.norm(away, axis=0).max(axis=1) <= tiled.tiles[3] * (1 + 1e-15))
    across = np.abs(np.einsum("ibm,ib->bm", away, tiled.tiles[7:10])).max(axis=1)
    assert np.all(across <= tiled.tiles[10] + 1e-15)
    assert np.median(tiled.tiles[10]) < 0.2 * np.median(tiled.tiles[3])
    area = np.linalg.norm(tiled.points[3:], axis=0)
    np.testing.assert_allclose(np.bincount(tiled.index, area, len(patch)), patch.areas_m2, rtol=1e-14)


def test_moved_patch_is_the_one_built_there():
    first = Patch.build(FINGER, LAYOUT, SensorPose(0.0, 0.0), 0.5e-3)
    there = Patch.build(FINGER, LAYOUT, POSE, 0.5e-3)
    moved = first.moved(there.points_m, there.normals)
    np.testing.assert_array_equal(moved.tiled.index, first.tiled.index)
    np.testing.assert_array_equal(moved.tiled.points[:3].T, there.points_m[moved.tiled.index])
