from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from skincal.fitting.laplace import Fold, log_volume


def _fold(r0: float, r1: float, b: float, stiff: float) -> tuple[Fold, float, float]:
    """A fold at the place that Gauss-Newton would find: the root of the parabola, or its bottom; and Q there."""
    a = 0.5 * r1**2 / b - r0
    place = (-r1 + np.sqrt(2 * b * a)) / b if a > 0 else -r1 / b
    slope, offset = r1 + b * place, r0 + r1 * place + 0.5 * b * place**2
    fold = Fold(
        np.array([-0.5 * np.log(slope**2 + stiff)]),
        np.array([slope**2 + stiff]),
        np.array([slope**2]),
        np.array([b / 2]),
        np.array([0.5 * slope**2 / b - offset]),
        np.zeros((1, 2)),
    )
    return fold, offset**2 + stiff * 0.0, float(place)


@pytest.mark.parametrize("a", [-6.0, -3.0, -1.0, -0.3, 0.0, 0.2, 0.7, 1.5, 3.0, 6.0, 12.0])
def test_the_volume_of_a_bent_residual_is_that_of_the_integral(a: float) -> None:
    """Mirror places counted one by one or together: the sum is the integral over both lobes."""
    b, r1 = 2.0, 0.0
    fold, q, _ = _fold(-a, r1, b, 1e-9)
    exact = quad(lambda v: np.exp(-0.5 * (-a + 0.5 * b * v * v) ** 2), -9, 9, limit=500, points=[-2, 0, 2])[0]
    lobes = 2 if a > 0.02 else 1
    one = np.sqrt(2 * np.pi) * np.exp(-0.5 * q + log_volume(fold, np.zeros(1))[0])
    assert lobes * one == pytest.approx(exact, rel=0.01)
    if a < 4.0:
        together = np.sqrt(2 * np.pi) * np.exp(-0.5 * q + log_volume(fold, np.full(1, lobes - 1.0))[0])
        assert together == pytest.approx(exact, rel=0.01)


def test_without_a_bend_it_is_laplace() -> None:
    fold = Fold(
        np.array([-0.5 * np.log(50.0)]),
        np.array([50.0]),
        np.array([40.0]),
        np.array([0.01]),
        np.array([40.0 / (4 * 0.01)]),
        np.zeros((1, 2)),
    )
    assert log_volume(fold, np.zeros(1))[0] == pytest.approx(-0.5 * np.log(50.0), abs=1e-3)
