"""The solver that the fit is judged by must itself be right: its compliance, both limits, the laws of contact."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm

from skincal.inference.elastic_layer import ContactError, ContactProblem, Layer, Press

LAYER = Layer.of_stiffness(4e8, 1.5e-3, 0.4)


def waves_of_a_bonded_layer(layer: Layer, k: float) -> float:
    """G(k) from the equations of equilibrium themselves: (U, W, U', W') carried from the core to the surface.

    u_x = U(z) sin kx, u_z = W(z) cos kx; bonded at z = 0; at z = h a pressure cos kx and no shear.
    """
    mu, nu = layer.shear_modulus_pa, layer.poisson
    lam = 2 * mu * nu / (1 - 2 * nu)
    both, sum_ = lam + 2 * mu, lam + mu
    carry = expm(
        layer.thickness_m
        * np.array(
            [
                [0, 0, 1, 0],
                [0, 0, 0, 1],
                [both / mu * k**2, 0, 0, sum_ / mu * k],
                [0, mu / both * k**2, -sum_ / both * k, 0],
            ]
        )
    )
    stress = np.array([[lam * k, 0, 0, both], [0, -mu * k, mu, 0]]) @ carry[:, 2:]
    slopes = np.linalg.solve(stress, [-1.0, 0.0])
    return -float(carry[1, 2:] @ slopes)


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45, 0.49])
@pytest.mark.parametrize("kh", [0.05, 0.5, 2.0, 6.0])
def test_compliance_follows_from_equilibrium(poisson: float, kh: float) -> None:
    layer = Layer(2e-3, 3e5, poisson)
    k = kh / layer.thickness_m
    assert layer.compliance(np.array(k)) == pytest.approx(waves_of_a_bonded_layer(layer, k), rel=1e-6)


def test_compliance_tends_to_foundation_and_half_space() -> None:
    k = np.array([0.0, 1e-3, 10.0, 1e5]) / LAYER.thickness_m
    compliance = LAYER.compliance(k)
    assert compliance[:2] == pytest.approx(1 / 4e8, rel=1e-5)
    assert compliance[2] == pytest.approx((1 - 0.4) / LAYER.shear_modulus_pa / k[2], rel=1e-4)
    assert compliance[3] == pytest.approx((1 - 0.4) / LAYER.shear_modulus_pa / k[3], rel=1e-12)


def test_thick_layer_is_hertz() -> None:
    young, nu, sphere, radius = 1e6, 0.4, 6e-3, 0.6e-3
    layer = Layer(5e-3, young / 2 / (1 + nu), nu)
    force = 4 * young / (1 - nu**2) * radius**3 / 3 / sphere
    press = Press(np.inf, sphere, spacing_m=0.05e-3, half_width_m=5e-3)
    [field] = press.fields(layer, np.array([force]))
    touched = np.sqrt((field.pressure_pa > 0).sum() * press.spacing_m**2 / np.pi)
    assert touched == pytest.approx(radius, rel=0.02)
    peak = 1.5 * force / np.pi / radius**2
    assert field.pressure_pa.max() == pytest.approx(peak, rel=0.01)
    away = np.hypot(*np.meshgrid(field.axis_m, field.axis_m))
    hertz = peak * np.sqrt(np.maximum(1 - (away / radius) ** 2, 0))
    assert np.linalg.norm(field.pressure_pa - hertz) < 0.03 * np.linalg.norm(hertz)

    # The core takes away what a half-space would give way far from the contact.
    def less(k: float) -> float:
        return float(layer.compliance(np.array(k))) * k - (1 - nu) / layer.shear_modulus_pa

    stiffer, _ = quad(less, 1e-3, 1e4, limit=200)
    assert field.approach_m == pytest.approx(radius**2 / sphere + force / 2 / np.pi * stiffer, rel=0.01)


def test_thin_layer_is_a_foundation() -> None:
    press = Press(11.5e-3, 6e-3)
    [field] = press.fields(Layer.of_stiffness(4e8, 0.02e-3, 0.3), np.array([2.5]))
    foundation = 4e8 * np.maximum(field.approach_m - press.gap_m, 0)
    assert np.abs(field.pressure_pa - foundation).max() < 0.02 * foundation.max()


def test_surfaces_touch_where_there_is_pressure_and_nowhere_overlap() -> None:
    press = Press(11.5e-3, 6e-3)
    fields = press.fields(LAYER, np.array([4.0, 1.0, 2.5]))
    problem = ContactProblem(LAYER, press.gap_m, press.spacing_m)
    for field in fields:
        apart = problem.displacement(field.pressure_pa) + press.gap_m - field.approach_m
        touched = field.pressure_pa > 0
        assert (field.pressure_pa >= 0).all()
        assert np.abs(apart[touched]).max() < 1e-5 * field.approach_m
        assert apart[~touched].min() > -1e-5 * field.approach_m
        assert field.pressure_pa.sum() * press.spacing_m**2 == pytest.approx(field.load_n)
        mirrored = field.pressure_pa[::-1, ::-1]
        assert np.abs(field.pressure_pa - mirrored).max() < 1e-3 * field.pressure_pa.max()
    assert [f.force_n for f in fields] == pytest.approx([4.0, 1.0, 2.5], rel=2e-5)
    assert fields[1].approach_m < fields[2].approach_m < fields[0].approach_m


def test_a_layer_moves_beside_the_place_that_is_pressed_and_a_foundation_does_not() -> None:
    press = Press(11.5e-3, 6e-3)
    beside = []
    for thickness in (0.02e-3, 0.5e-3, 2e-3):
        layer = Layer.of_stiffness(4e8, thickness, 0.4)
        [field] = press.fields(layer, np.array([3.0]))
        moved = ContactProblem(layer, press.gap_m, press.spacing_m).displacement(field.pressure_pa)
        beside.append(np.abs(moved[field.pressure_pa == 0]).max() / field.approach_m)
    assert beside[0] < 0.02
    assert 0.03 < beside[1] < beside[2]


def test_contact_beyond_the_grid_is_refused() -> None:
    with pytest.raises(ContactError, match="border of the grid"):
        Press(11.5e-3, 6e-3, half_width_m=1.5e-3).fields(LAYER, np.array([4.0]))
