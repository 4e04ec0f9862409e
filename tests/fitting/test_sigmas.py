from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from skincal.fitting.laplace import log_integral
from skincal.fitting.presses import PressStates, factor_inverse
from skincal.fitting.shared import Shared
from skincal.fitting.sigmas import _maximise_scatter, _scatter_loss
from skincal.fitting.types import Floats


def _positive(rng: np.random.Generator, count: int, size: int) -> Floats:
    some = rng.normal(size=(count, size, size + 2))
    return np.matmul(some, some.transpose(0, 2, 1))


def test_half_of_an_inverse() -> None:
    hessian = _positive(np.random.default_rng(0), 20, 3) * np.array([1e6, 1e3, 1.0]) * [[1e6], [1e3], [1.0]]
    root, log_volume = factor_inverse(hessian)
    unit = np.matmul(np.matmul(root, root.transpose(0, 2, 1)), hessian)
    assert unit == pytest.approx(np.broadcast_to(np.eye(3), unit.shape), abs=1e-6)
    assert log_volume == pytest.approx(-0.5 * np.linalg.slogdet(hessian)[1])


def test_noise_and_misfit_end_where_a_general_search_ends() -> None:
    rng = np.random.default_rng(1)
    signal = rng.exponential(20.0, 400)
    parts = np.array([np.ones(400), signal**2])
    squares = rng.normal(size=400) ** 2 * (0.3**2 + (0.02 * signal) ** 2)
    centres, start = np.log([0.25, 0.01]), np.log([1.0, 0.2])
    found = _maximise_scatter(squares, parts, centres, start)
    whole = minimize(
        lambda x: _scatter_loss(squares, parts, centres, x)[0], start, method="Nelder-Mead", tol=1e-9
    )
    assert found == pytest.approx(whole.x, abs=1e-4)
    assert found == pytest.approx(np.log([0.3, 0.02]), abs=0.15)


def test_shared_errors_are_integrated_with_the_mean_gain_held() -> None:
    """Against the integral over an orthonormal basis of what is free, press by press and without shortcuts."""
    rng = np.random.default_rng(2)
    presses, taxels, fields = 7, 5, 2
    alive = np.array([True, True, False, True, True])
    basis = rng.normal(size=(presses, fields))
    shared = Shared.none(np.full(taxels, 0.4), basis, np.zeros(fields))
    shared = shared.with_theta(0.01 * rng.normal(size=len(shared.theta)))
    gain, level = rng.normal(size=(2, 1, presses, taxels)) * alive
    slope = rng.normal(size=(1, presses, taxels, 3)) * alive[:, None]
    residual, nuisance = rng.normal(size=(1, presses, taxels)) * alive, rng.normal(size=(presses, 3))
    sigmas = np.tile([3.0**-0.5, 0.7, 1.0, 0.01, 0.1, 0.2], (presses, 1))
    stiff, precision = np.array([3.0]), shared.precision(np.array([0.1]), np.array([0.2]))
    own = np.matmul(slope.transpose(0, 1, 3, 2), slope)[0] + 4.0 * np.eye(3)
    none, macro_slope = np.zeros(presses), np.zeros((presses, taxels, 5))
    macro_slope[..., 4] = gain[0]
    state = PressStates(
        np.arange(presses), np.zeros((presses, 5)), sigmas, nuisance, none, own, np.zeros((presses, 2)), residual[0],
        residual[0], macro_slope, slope[0], level[0],
    )  # fmt: skip
    got = log_integral(shared, state, np.ones((1, presses)), alive)[0]
    slack = (nuisance - shared.centre)[None, :, :2]
    pull = ((nuisance - shared.centre) * [3.0, 3.0, 0.7**-2])[None]

    size = len(shared.theta)
    hessian, slopes = np.diag(precision[0]), precision[0] * shared.theta
    for k in range(presses):
        by = np.zeros((taxels, size))
        by[range(taxels), range(taxels)] = gain[0, k]
        by[range(taxels), range(taxels, 2 * taxels)] = level[0, k]
        field = np.zeros((2, size))
        for d in range(2):
            field[d, 2 * taxels + d * fields : 2 * taxels + (d + 1) * fields] = basis[k]
        mixed = by.T @ slope[0, k]
        mixed[:, :2] -= stiff[0] * field.T
        solved = cho_factor(own[k])
        hessian = hessian + by.T @ by + stiff[0] * field.T @ field - mixed @ cho_solve(solved, mixed.T)
        off = slope[0, k].T @ residual[0, k] + pull[0, k]
        slopes = (
            slopes + by.T @ residual[0, k] - stiff[0] * field.T @ slack[0, k] - mixed @ cho_solve(solved, off)
        )
    way = shared.directions(alive)
    free, g = way.T @ hessian @ way, way.T @ slopes
    expected = 0.5 * g @ np.linalg.solve(free, g) - 0.5 * np.linalg.slogdet(free)[1]
    expected += 0.5 * np.log((way**2).T @ precision[0]).sum() - 0.5 * (precision[0] * shared.theta**2).sum()
    assert got == pytest.approx(expected, rel=1e-9)
