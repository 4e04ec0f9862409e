from __future__ import annotations

import numpy as np
import pytest
from published import LAYOUT
from scipy.ndimage import gaussian_filter

from skincal.fitting.kernel import build_table, gaussian_blur
from skincal.fitting.lookup import look_up_cubic
from skincal.model import (
    Contacts,
    Converter,
    Cylinder,
    FlatPunch,
    Indenter,
    Patch,
    Plane,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    Surface,
    TaxelLayout,
)
from tests.fitting.looking import look_up_level, shares

UNEVEN = TaxelLayout(
    1,
    3,
    np.array([[-0.004, 0.0], [0.0, 0.001], [0.005, 0.0]]),
    np.array([[0.002, 0.003], [0.001, 0.001], [0.003, 0.002]]),
)


def test_cubic_look_up_is_exact_for_quadratics() -> None:
    axis = np.arange(12.0)
    plane = (axis[:, None] - 5) ** 2 + 2 * axis[None, :] * axis[:, None]
    rng = np.random.default_rng(0)
    row, col = rng.uniform(2, 9, (2, 50)).astype(np.float32)
    got = look_up_cubic(plane[None].astype(np.float32), np.zeros(50, dtype=np.intp), row, col)
    assert got[0] == pytest.approx((row - 5) ** 2 + 2 * row * col, rel=1e-5, abs=1e-4)
    assert got[1] == pytest.approx(2 * (row - 5) + 2 * col, rel=1e-4, abs=1e-3)
    assert got[2] == pytest.approx(2 * row, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize(
    ("surface", "indenter", "layout"),
    [
        (Cylinder(0.0115), Sphere(0.006), LAYOUT),
        (Plane(), Sphere(0.004), LAYOUT),
        (Cylinder(0.02), Sphere(0.003), UNEVEN),
        (Plane(), FlatPunch(0.003), LAYOUT),
    ],
)
def test_images_agree_with_the_skin_model(surface: Surface, indenter: Indenter, layout: TaxelLayout) -> None:
    """The kernel integrates the pressure, the model sums it at points 0.1 mm apart: they agree to 1 %."""
    alpha, elasticity, rng = 0.15, 4e8, np.random.default_rng(3)
    force = rng.uniform(1, 4, 12)
    uv = rng.uniform(-5e-3, 5e-3, (12, 2))
    patch = Patch.build(surface, layout, SensorPose(0.02, alpha), resolution_m=0.1e-3)
    points, normals = surface.wrap(SensorPose(0.02, alpha), uv)
    model = Skin(patch, SkinParameters(elasticity, 1.0), Converter.none())
    expected = model.values(indenter, Contacts(points, normals, force))
    ratios = np.log(force / elasticity)
    images = build_table(
        surface, (indenter,), layout, np.radians([5.0, 10.0]), (ratios.min() - 0.1, ratios.max() + 0.1)
    )
    got = shares(images, uv, np.full(12, alpha), ratios, np.zeros(12, dtype=np.intp))
    assert expected.max() > 0.3
    # A flat punch's pressure ends in a step, which a lattice of 0.1 mm blurs; a sphere's does not.
    tolerance = 0.06 if isinstance(indenter, FlatPunch) else 0.01
    assert force[:, None] * got.value == pytest.approx(expected, abs=tolerance * expected.max())


def test_derivatives_agree_with_finite_differences() -> None:
    images = build_table(Cylinder(0.0115), (Sphere(0.006),), LAYOUT, np.radians([-5, 0, 5.0]), (-21.0, -18.5))
    rng = np.random.default_rng(1)
    n = 40
    uv, alpha = rng.uniform(-6e-3, 6e-3, (n, 2)), rng.uniform(-0.08, 0.08, n)
    ratio, kind = rng.uniform(-20.5, -19.0, n), np.zeros(n, dtype=np.intp)
    got = shares(images, uv, alpha, ratio, kind)
    for name, du, da, dr in (
        ("by_u", [2e-6, 0], 0, 0),
        ("by_v", [0, 2e-6], 0, 0),
        ("by_alpha", [0, 0], 1e-3, 0),
        ("by_log_ratio", [0, 0], 0, 1e-3),
    ):
        ahead = shares(images, uv + du, alpha + da, ratio + dr, kind).value
        behind = shares(images, uv - du, alpha - da, ratio - dr, kind).value
        slope = (ahead - behind) / (2 * (sum(du) + da + dr))
        analytic = getattr(got, name)
        assert np.abs(slope - analytic).max() < 0.02 * np.abs(analytic).max(), name


def test_one_level_gives_the_same_images_as_the_whole_table() -> None:
    images = build_table(
        Cylinder(0.0115), (Sphere(0.006), Sphere(0.004)), LAYOUT, np.zeros(1), (-21.0, -18.5)
    )
    rng = np.random.default_rng(2)
    uv, ratio = rng.uniform(-6e-3, 6e-3, (30, 2)), rng.uniform(-20.5, -19.0, 30)
    kind = rng.integers(0, 2, 30)
    planes, lattice = images.level(0, ratio, kind)
    near, out = np.empty(LAYOUT.taxels, dtype=np.int64), np.empty((30, 3, LAYOUT.taxels))
    for k, (u, v) in enumerate(uv):
        look_up_level(planes, images.size_of, LAYOUT.centres_m, lattice, u, v, k, near, out[k])
    value, by_u, by_v = out.transpose(1, 0, 2)
    whole = shares(images, uv, np.zeros(30), ratio, kind)
    assert value == pytest.approx(whole.value, abs=1e-5)
    assert by_u == pytest.approx(whole.by_u, abs=0.02)
    assert by_v == pytest.approx(whole.by_v, abs=0.02)


def test_the_pressure_itself_carries_the_whole_force_on_a_plane() -> None:
    whole = TaxelLayout.grid(1, 1, taxel_size_m=0.008, pitch_m=0.008)
    where = (np.zeros((1, 2)), np.zeros(1), np.array([-19.5]), np.zeros(1, dtype=np.intp))
    projected, bare = (
        shares(
            build_table(Plane(), (Sphere(0.006),), whole, np.zeros(1), (-20.0, -19.0), projected=p), *where
        ).value[0, 0]
        for p in (True, False)
    )
    assert bare == pytest.approx(1.0, abs=2e-3)
    # Depth over diameter: a mean of the cosine of the sphere's normal.
    assert 0.93 < projected < 0.98


def test_spread_keeps_the_force_and_widens_the_contact() -> None:
    tight = TaxelLayout.grid(9, 9, taxel_size_m=0.001, pitch_m=0.001)
    where = (np.zeros((1, 2)), np.zeros(1), np.array([-19.5]), np.zeros(1, dtype=np.intp))
    plain, spread = (
        shares(
            build_table(Plane(), (Sphere(0.006),), tight, np.zeros(1), (-20.0, -19.0), spread_m=s), *where
        ).value[0]
        for s in (0.0, 0.5e-3)
    )
    assert spread.sum() == pytest.approx(plain.sum(), rel=0.02)
    assert spread[40] < plain[40]


@pytest.mark.parametrize("sigma", [0.0, 0.6, 1.0, 3.7])
def test_blur_is_a_gaussian_filter(sigma: float) -> None:
    field, blur = np.random.default_rng(0).uniform(0, 1, (41, 41)), gaussian_blur(41, sigma)
    expected = gaussian_filter(field, sigma, mode="constant") if sigma else field
    assert blur @ field @ blur == pytest.approx(expected, abs=1e-14)
