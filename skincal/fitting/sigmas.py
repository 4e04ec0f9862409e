"""The sigmas of a fit: their priors, and their estimation during a climb.

They are the sigmas of positions, forces, hold means, misfit, gains and the smooth error of positions, in the
order of :data:`skincal.fitting.presses.HYPER`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from skincal.fitting.lookup import allocating
from skincal.fitting.presses import PressStates, factor_inverse
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Floats
from skincal.model.press.jit import reporting_compilation

FORCE_SIGMA, MISFIT, GAIN_SIGMA, FIELD_PART = 0.005, 0.01, 0.015, 0.03
"""Prior medians of sigma_f, tau and sigma_g, and that of sigma_b as a fraction of the position's sigma."""

SPREADS = np.array([0.6, 1.0, 0.2, 1.2, 1.2, 1.0])
"""Prior standard deviations of the logs of the sigmas, in the order of ``HYPER``.

Those of sigma_p and sigma_n are the uncertainty of the rig's declaration and of the scatter of untouched
taxels. The others only fix the order of magnitude."""

_TRUSTED = 16.0
"""A press whose mean square exceeds the typical one by this factor is down-weighted."""

_TRIMMED = 9.0
"""In a climb from afar, presses whose mean square exceeds the typical one by this factor do not enter the noise
estimate."""

_SCORINGS, _SCORED = 30, 1e-5
"""Most Fisher scoring steps for the sigmas of the readings, and the tolerance of their logs."""

_FAR_NOISE = 0.02
"""A climb from afar starts with this fraction of the typical signal as noise, and with the same misfit."""


def log_centres(problem: FitProblem) -> Floats:
    """Return the prior means (6,) of the logs of the sigmas."""
    sigma, noise = problem.rig.position_sigma_m, problem.noise_sigma_counts
    position = sigma if np.isfinite(sigma) and sigma > 0 else problem.rig.slack_m
    return np.log([position, FORCE_SIGMA, noise, MISFIT, GAIN_SIGMA, FIELD_PART * position])


def log_prior(problem: FitProblem, log_sigma: Floats) -> Floats:
    """Return the log prior (W,) of the sigmas; the macro variables have flat priors, with E and S by their logs."""
    return -0.5 * (((log_sigma - log_centres(problem)) / SPREADS) ** 2).sum(axis=1)


def initial_sigmas(problem: FitProblem) -> Floats:
    """Return sigmas (6,) for a climb from afar: wide, and without shared errors."""
    sigmas = np.exp(log_centres(problem))
    wide = _FAR_NOISE * problem.observation.typical_counts
    sigmas[:4] = [0.7 * sigmas[0], 0.01, max(wide, problem.noise_sigma_counts), _FAR_NOISE]
    return sigmas


def weigh_presses(state: PressStates) -> Floats:
    """Return the robust weight (K,) of each press: less than one if it fits far worse than the others."""
    squares = (state.residual**2).mean(axis=1)
    return np.minimum(1.0, _TRUSTED * max(float(np.median(squares)), 1.0) / np.maximum(squares, 1e-30))


def update_sigmas(problem: FitProblem, state: PressStates, sigmas: Floats, known: Floats | None) -> Floats:
    """Return the sigmas (6,) after one step of expectation-maximisation, with the priors of :func:`log_prior`.

    A press that fits far worse than the others counts no more than the bound of :func:`weigh_presses`. ``known``
    (T,) are the posterior variances of the shared errors; None in a climb from afar, which has none.
    """
    centres = np.exp(log_centres(problem))
    root = factor_inverse(state.hessian)[0]
    second = (state.nuisance - problem.shared.centre) ** 2 + (root**2).sum(axis=2)
    second = np.minimum(second, _TRUSTED * np.median(second, axis=0))
    position = _estimate_sigma(second[:, :2].sum(), second[:, :2].size, centres[0], SPREADS[0])
    force = _estimate_sigma(second[:, 2].sum(), len(second), centres[1], SPREADS[1])
    noise, misfit = _estimate_noise(problem, state, sigmas, root, trimmed=known is None)
    updated = np.array([position, force, noise, misfit, *sigmas[4:]])
    if known is not None:
        taxels = problem.rig.layout.taxels
        spread = problem.shared.theta**2 + known
        updated[4] = _estimate_sigma(spread[:taxels].sum(), taxels, centres[4], SPREADS[4])
        field = spread[2 * taxels :]
        if len(field):
            updated[5] = _estimate_sigma(field.sum(), len(field), centres[5], SPREADS[5])
    return updated


def _estimate_noise(
    problem: FitProblem, state: PressStates, sigmas: Floats, root: Floats, *, trimmed: bool
) -> tuple[float, float]:
    """Return the MAP of sigma_n and tau, given squared residuals and the variance that the nuisance leaves."""
    used = problem.used
    if trimmed:
        # In a climb from afar, outlier presses have not been removed yet, and a larger misfit would
        # hide them.
        squares = (state.residual**2).mean(axis=1)
        used = used & (squares <= _TRIMMED * np.median(squares))[:, None]
    model = problem.observation
    own, grown = model.parts(used)
    variance = sigmas[2] ** 2 * own + sigmas[3] ** 2 * grown
    spread = np.matmul(state.nuisance_slope, root)
    squares = state.residual**2 + np.einsum("njd,njd->nj", spread, spread)
    squares = (weigh_presses(state)[:, None] * squares)[used] * variance
    centres = log_centres(problem)[2:4]
    # The loss may have two minima, one where noise explains the squares and one where misfit does: start
    # from the better of two guesses.
    grown_only = 0.5 * float(np.log(squares.sum() / max(float(grown.sum()), 1e-300)))
    parts = np.array([own, grown])
    starts = np.log(sigmas[2:4]), np.array([centres[0], max(float(centres[1]), grown_only)])
    with reporting_compilation():
        start = min(starts, key=lambda x: _scatter_loss(squares, parts, centres, x)[0])
        noise, misfit = np.exp(_maximise_scatter(squares, parts, centres, start))
    return max(float(noise), model.floor_counts * 1.05), float(misfit)


@allocating
def _scatter_loss(
    squares: Any, parts: Any, centres: Any, x: Any
) -> tuple[float, Floats, Floats]:  # pragma: no cover - compiled
    """Return minus the log posterior of log sigma_n and log tau (2,), its gradient, and its expected Hessian."""
    value, slope, curvature = 0.0, np.empty(2), np.zeros((2, 2))
    for i in range(2):
        spread = SPREADS[2 + i]
        slope[i], curvature[i, i] = (x[i] - centres[i]) / (spread * spread), 1.0 / (spread * spread)
        value += 0.5 * slope[i] * (x[i] - centres[i])
    noise, misfit = math.exp(2.0 * x[0]), math.exp(2.0 * x[1])
    for n in range(len(squares)):
        one, two = noise * parts[0, n], misfit * parts[1, n]
        total = one + two
        one, two, left = one / total, two / total, squares[n] / total
        value += 0.5 * (left + math.log(total))
        slope[0] += one * (1.0 - left)
        slope[1] += two * (1.0 - left)
        curvature[0, 0] += 2.0 * one * one
        curvature[0, 1] += 2.0 * one * two
        curvature[1, 1] += 2.0 * two * two
    curvature[1, 0] = curvature[0, 1]
    return value, slope, curvature


def _maximise_scatter(squares: Floats, parts: Floats, centres: Floats, x: Floats) -> Floats:
    """Minimise :func:`_scatter_loss` by Fisher scoring with backtracking, from ``x`` (2,)."""
    value, slope, curvature = _scatter_loss(squares, parts, centres, x)
    for _ in range(_SCORINGS):
        step = -np.linalg.solve(curvature, slope)
        step *= min(1.0, 1.0 / float(np.abs(step).max()))
        tried = _scatter_loss(squares, parts, centres, x + step)
        while tried[0] > value and np.abs(step).max() > _SCORED:
            step *= 0.3
            tried = _scatter_loss(squares, parts, centres, x + step)
        if tried[0] > value:
            break
        x, (value, slope, curvature) = x + step, tried
        if np.abs(step).max() < _SCORED:
            break
    return x


def _estimate_sigma(squares: float, count: int, centre: float, spread: float) -> float:
    """Return the MAP of a sigma with a log-normal prior, by Newton steps in its log."""
    x, middle = 0.5 * math.log(max(squares / count, 1e-300)), math.log(centre)
    for _ in range(20):
        explained = squares * math.exp(-2 * x)
        x += (-count + explained - (x - middle) / spread**2) / (2 * explained + 1 / spread**2)
    return math.exp(x)
