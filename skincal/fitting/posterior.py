"""The joint posterior of the macro variables, with positions, forces and shared errors marginalised.

From the best grid points on, the fit is continuous, with the likelihood of the absolute images
(:mod:`skincal.fitting.readings`). Slack and force error of each press are Gaussian, and so are the errors that
presses share (:mod:`skincal.fitting.shared`); their sigmas are estimated along with the macro variables, so that
intervals widen on a rig that is worse than declared. Integrals are Laplace approximations, summed over all
possible positions of a press. :mod:`skincal.fitting.sampling` draws from it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from skincal.fitting.laplace import (
    eliminate_nuisance,
    log_integral,
    log_volume,
    measure_fold,
    sum_by_press,
    weigh_untracked_mirrors,
)
from skincal.fitting.lattice import best_of_each
from skincal.fitting.places import find_duplicates, find_places, find_tracked_mirrors
from skincal.fitting.presses import Places, PressModel, PressStates, factor_inverse
from skincal.fitting.problem import FitProblem
from skincal.fitting.sigmas import (
    SPREADS,
    initial_sigmas,
    log_centres,
    log_prior,
    update_sigmas,
    weigh_presses,
)
from skincal.fitting.types import Floats

ITERATIONS = 12
"""Most full Gauss-Newton steps of the nuisance at one point of the posterior."""

STEPS = 25
"""Most steps of a climb."""

_SEARCHES_FAR, _SEARCHES_NEAR = (3, 6, 10, 15), (3, 8)
"""Steps of a climb before which the contact positions are searched again, if it does not end after the first of them:
from afar, and from a nearby peak."""
_CONVERGED = 0.01
"""A climb ends at a Gauss-Newton step that promises less than this in log density: a numerical tolerance."""
_PLAIN_STEPS, _MOST_RELAXATION, _SIGMAS_CONVERGED = 6, 8.0, 5e-3
"""For the first ``_PLAIN_STEPS`` steps from afar, the sigmas take plain EM steps. After that, the steps are
over-relaxed, by ``_MOST_RELAXATION`` at most, until the logs of the sigmas change by less than
``_SIGMAS_CONVERGED``."""

_UNITS = np.array([1e3, 1e3, 1.0, 1.0, 1.0])
"""Units of the macro variables in the evidence: millimetres instead of metres keep the determinant away from
underflow."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Box of the macro variables: (5,) low and high, in the order of ``MACRO``."""

    low: Floats
    high: Floats


@dataclass(frozen=True, eq=False)
class Peak:
    """The maximum of the posterior (MAP).

    Attributes:
        macro: (5,) macro variables.
        sigmas: (6,) in the order of ``HYPER``.
        theta: (T,) errors that all presses share.
        covariance: (5, 5) Laplace covariance of the macro variables.
        places: possible contact positions of each press, seen from here.
        states: the presses at their best positions.
        log_density: unnormalised log posterior.
    """

    macro: Floats
    sigmas: Floats
    theta: Floats
    covariance: Floats
    places: Places
    states: PressStates
    log_density: float

    @property
    def log_evidence(self) -> float:
        """Log of the probability mass under the peak (Laplace approximation), up to a constant."""
        scaled = self.covariance * np.outer(_UNITS, _UNITS)
        return self.log_density + 0.5 * float(np.linalg.slogdet(scaled)[1])


_PRIOR_SIGMAS = 12.0
"""The density is zero where the log of a sigma is this many prior standard deviations from its prior mean."""


def log_posterior(model: PressModel, places: Places, bounds: Bounds, points: Floats) -> Floats:
    """Return the unnormalised log posterior (W,) of points (W, 11): macro variables and logs of the six sigmas."""
    problem = model.problem
    inside = ((points[:, :5] >= bounds.low) & (points[:, :5] <= bounds.high)).all(axis=1)
    inside &= points[:, 7] > np.log(problem.observation.floor_counts)
    inside &= (np.abs(points[:, 5:] - log_centres(problem)) < _PRIOR_SIGMAS * SPREADS).all(axis=1)
    out = np.full(len(points), -np.inf)
    if inside.any():
        points = points[inside]
        total, chance, state = press_evidence(model, places, points)
        # Normalisation of the likelihood: the logs of the standard deviations of all readings.
        own, grown = problem.observation.parts(problem.used)
        noise, misfit = np.exp(2 * points[:, 7:9, None]).transpose(1, 0, 2)
        total = total - 0.5 * np.log(noise * own + misfit * grown).sum(axis=1)
        total = total + log_integral(problem.shared, state, chance, problem.alive)
        out[inside] = total + log_prior(problem, points[:, 5:])
    return out


def press_evidence(model: PressModel, places: Places, points: Floats) -> tuple[Floats, Floats, PressStates]:
    """Return the log evidence (W,) of all presses by Laplace approximations at their positions, up to a constant.

    Also return the probability (W, N) of each position of a press, and the presses fitted there (W * N). Points
    (W, 11) are as for :func:`log_posterior`.
    """
    count, spots = len(points), len(places.press)
    state = model.fit_at_places(places, points[:, :5], np.exp(points[:, 5:]), iterations=ITERATIONS)
    fold = measure_fold(model, state)
    tracked = find_tracked_mirrors(places.press, state.nuisance[:, :2], fold.mirror_m, count)
    evidence = -0.5 * state.objective + log_volume(fold, weigh_untracked_mirrors(model, state, fold, tracked))
    twice = find_duplicates(places.press, state.uv_m.reshape(count, spots, 2), fold)
    evidence = np.where(twice, -np.inf, evidence.reshape(count, spots))
    total, chance = sum_by_press(places.press, evidence)
    return total - len(model.problem) * (2 * points[:, 5] + points[:, 6]), chance, state


def climb(model: PressModel, bounds: Bounds, start: Floats, *, sigmas: Floats | None = None) -> Peak:
    """Maximise the posterior from a start: Gauss-Newton over all variables, the sigmas by expectation-maximisation.

    Args:
        model: the presses, with tables of the neighbourhood.
        bounds: box of the macro variables.
        start: (5,) macro variables to start from.
        sigmas: (6,) of a nearby peak. None for a climb from afar: it starts with wide sigmas and without
            shared errors, which makes it converge from a distance.
    """
    macro = np.clip(start, bounds.low, bounds.high)
    far = sigmas is None
    if sigmas is None:
        sigmas = initial_sigmas(model.problem)
    damping, places, relaxation, last = 1e-3, None, np.ones(len(sigmas)), np.zeros(len(sigmas))
    searches = _SEARCHES_FAR if far else _SEARCHES_NEAR
    for step_number in range(STEPS):
        problem = model.problem
        if places is None or step_number in searches:
            places = find_places(model, macro, sigmas)
        here, states = _fit_presses(model, places, macro, sigmas)
        trust = weigh_presses(states)
        value = _objective(problem, states, trust)
        gradient, curvature = _reduced_derivatives(problem, states, trust, shared=not far)
        damped = curvature + np.diag(damping * np.diag(curvature) + 1e-9)
        step = -np.linalg.solve(damped, gradient)
        limit = np.array([0.5e-3, 0.5e-3, 0.1, 0.4, 0.2])
        step *= min(1.0, float((limit / np.maximum(np.abs(step[:5]), 1e-30)).min()))
        trial = np.clip(macro + step[:5], bounds.low, bounds.high)
        changed = (
            model if far else replace(model, problem=problem.with_shared(problem.shared.theta + step[5:]))
        )
        there, tried = _fit_presses(changed, here, trial, sigmas)
        if _objective(changed.problem, tried, trust) <= value + 1e-9:
            converged = -gradient @ step < _CONVERGED and step_number > searches[0]
            macro, damping, model = trial, damping * 0.2, changed
            places, states = there, tried
        else:
            converged, damping = False, max(damping, 1e-4) * 10
        known = None if far else np.diag(scaled_inverse(curvature))[5:]
        updated = update_sigmas(model.problem, states, sigmas, known)
        step = np.log(updated / sigmas)
        if not far or step_number > _PLAIN_STEPS:
            # Expectation-maximisation converges linearly: the ratio of two steps tells how much is left (Aitken).
            ratio = step / np.where(last == 0.0, np.inf, last)
            relaxation = np.clip(relaxation / np.maximum(1.0 - ratio, 1e-3), 1.0, _MOST_RELAXATION)
        last, sigmas = step, sigmas * np.exp(relaxation * step)
        sigmas[2] = max(sigmas[2], model.problem.observation.floor_counts * 1.05)
        if converged and np.abs(step).max() < _SIGMAS_CONVERGED:
            break
    assert places is not None
    return _build_peak(model, bounds, macro, sigmas, places)


def _build_peak(model: PressModel, bounds: Bounds, macro: Floats, sigmas: Floats, places: Places) -> Peak:
    """Return the peak where a climb ended, with the mean log gain moved into the scale."""
    theta, alive = model.problem.shared.theta.copy(), np.flatnonzero(model.problem.alive)
    mean = float(theta[alive].mean()) if len(alive) else 0.0
    theta[alive] -= mean
    macro, problem = macro + mean * np.array([0.0, 0.0, 0.0, 0.0, 1.0]), model.problem.with_shared(theta)
    model = replace(model, problem=problem)
    places, states = _fit_presses(model, places, macro, sigmas)
    _, curvature = _reduced_derivatives(problem, states, weigh_presses(states))
    # A direction that the presses leave open is still confined to the box: add the precision of a uniform
    # prior there.
    curvature[range(5), range(5)] += 12.0 / (bounds.high - bounds.low) ** 2
    way = block_diag(np.eye(5), problem.shared.directions(problem.alive))
    covariance = scaled_inverse(way.T @ curvature @ way)
    point = np.concatenate([macro, np.log(sigmas)])[None]
    density = float(log_posterior(model, places, bounds, point)[0])
    return Peak(macro, sigmas, theta, covariance[:5, :5], places, states, density)


def _fit_presses(
    model: PressModel, places: Places, macro: Floats, sigmas: Floats
) -> tuple[Places, PressStates]:
    """Fit the nuisance at one macro point; return all positions, and each press at its best one."""
    state = model.fit_at_places(places, macro[None], sigmas[None], iterations=6)
    score = state.objective - 2 * factor_inverse(state.hessian)[1]
    return state.places, state.take(best_of_each(places.press, score, len(model.problem)))


def _objective(problem: FitProblem, state: PressStates, trust: Floats) -> float:
    """Return Q of all presses, with their weights, and of the shared errors."""
    precision = problem.shared.precision(state.sigmas[:1, 4], state.sigmas[:1, 5])[0]
    return float(trust @ state.objective + (precision * problem.shared.theta**2).sum())


def _reduced_derivatives(
    problem: FitProblem, state: PressStates, trust: Floats, *, shared: bool = True
) -> tuple[Floats, Floats]:
    """Return gradient (5 + T,) and Hessian of Q/2 by macro variables and, if ``shared``, the shared errors."""
    gradient, curvature = (
        array[0] for array in eliminate_nuisance(problem.shared, state, trust[None], macro=True)
    )
    if not shared:
        return gradient[:5], curvature[:5, :5]
    precision = problem.shared.precision(state.sigmas[:1, 4], state.sigmas[:1, 5])[0]
    gradient[5:] += precision * problem.shared.theta
    curvature[range(5, len(curvature)), range(5, len(curvature))] += precision
    return gradient, (curvature + curvature.T) / 2


def scaled_inverse(matrix: Floats) -> Floats:
    """Return the pseudo-inverse of a positive matrix whose rows have different units."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    inverse = np.linalg.pinv(matrix * np.outer(scale, scale), hermitian=True)
    with np.errstate(over="ignore"):  # the variance of what the data do not determine may be infinite
        return inverse * np.outer(scale, scale)
