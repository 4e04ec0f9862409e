"""The joint posterior of the macro variables, with positions, forces and shared errors integrated out.

On the grid each press is placed by its normalised image. The ratios of two or three taxels do not tell a whole place,
so there the loss stays far above the noise of good data, and its least point is off. From the best grid points on, the
fit therefore goes on continuously, with the likelihood of the absolute images (:mod:`skincal.fitting.readings`): the
slack of each press is Gaussian (sigma_p), so is the error of its force (sigma_f), and so are the errors that presses
share (:mod:`skincal.fitting.shared`). All sigmas are estimated from the data along with the macro variables, so that
intervals widen by themselves on a rig that is worse than it says, and where the model does not quite fit. Integrals
over slack and force are Laplace's, summed over all places that a press could have been; the macro variables and the
sigmas are sampled in :mod:`skincal.fitting.sampling`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from skincal.fitting.lattice import best_of_each
from skincal.fitting.places import find_places, mirrored, settled_twice
from skincal.fitting.presses import Places, PressModel, PressStates, half_inverse
from skincal.fitting.problem import FitProblem
from skincal.fitting.shared_integral import eliminated, log_integral
from skincal.fitting.sigmas import SPREADS, estimated_sigmas, far_sigmas, log_centres, log_prior, trust_of
from skincal.fitting.types import Floats
from skincal.fitting.volume import fold_of, log_volume, untracked

SETTLE = 12

STEPS = 25
"""Steps of a climb at most; places are searched anew a few times on the way."""

_SEARCHES_FAR, _SEARCHES_NEAR = (3, 6, 10, 15), (2, 5)
"""Steps of a climb before which places are searched anew: from afar, and from a peak nearby."""
_WIDE, _BEYOND, _SIGMAS_REST = 6, 1.6, 5e-3
"""So many steps the sigmas only follow; then they go so much further than told, until they change by no more."""

_UNITS = np.array([1e3, 1e3, 1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Bounds:
    """The box of the macro variables: (5,) low and high, in the order of ``MACRO``."""

    low: Floats
    high: Floats


@dataclass(frozen=True, eq=False)
class Peak:
    """The most probable point.

    Attributes:
        macro: (5,) macro variables.
        sigmas: (6,) in the order of ``HYPER``.
        theta: (T,) errors that all presses share.
        covariance: (5, 5) of the macro variables, Laplace.
        places: where each press could have been, seen from here.
        states: the presses at their best places.
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
        """Logarithm of the mass under the peak (Laplace), up to a constant."""
        # Millimetres and the like keep the determinant away from underflow; a constant factor does not matter.
        scaled = self.covariance * np.outer(_UNITS, _UNITS)
        return self.log_density + 0.5 * float(np.linalg.slogdet(scaled)[1])


_FARTHEST = 12.0
"""Sigmas so many standard deviations of their prior from its middle are as good as impossible."""


def log_posterior(model: PressModel, places: Places, bounds: Bounds, points: Floats) -> Floats:
    """Unnormalised log posterior (W,) of points (W, 11): five macro variables and the logarithms of six sigmas."""
    problem = model.problem
    inside = ((points[:, :5] >= bounds.low) & (points[:, :5] <= bounds.high)).all(axis=1)
    inside &= points[:, 7] > np.log(problem.observation.floor_counts)
    inside &= (np.abs(points[:, 5:] - log_centres(problem)) < _FARTHEST * SPREADS).all(axis=1)
    out = np.full(len(points), -np.inf)
    if inside.any():
        points = points[inside]
        total, chance, state = press_evidence(model, places, points)
        # Less the logarithms of the standard deviations of all readings.
        own, grown = problem.observation.parts(problem.used)
        noise, misfit = np.exp(2 * points[:, 7:9, None]).transpose(1, 0, 2)
        total = total - 0.5 * np.log(noise * own + misfit * grown).sum(axis=1)
        total = total + log_integral(problem.shared, state, chance, problem.alive)
        out[inside] = total + log_prior(problem, points[:, 5:])
    return out


def press_evidence(model: PressModel, places: Places, points: Floats) -> tuple[Floats, Floats, PressStates]:
    """Log evidence (W,) of all presses by Laplace's approximation at their places, up to a constant.

    Args:
        model: the presses.
        places: where each press could have been.
        points: (W, 11) macro variables and logarithms of the sigmas.

    Returns:
        The evidence, the probability of each place of a press (W, N), and the presses settled there (W * N).
    """
    count, spots = len(points), len(places.press)
    state = model.settle_at(places, points[:, :5], np.exp(points[:, 5:]), iterations=SETTLE)
    fold = fold_of(model, state)
    tracked = mirrored(places.press, state.nuisance[:, :2], fold.mirror_m, count)
    evidence = -0.5 * state.objective + log_volume(fold, untracked(model, state, fold, tracked))
    twice = settled_twice(places.press, state.uv_m.reshape(count, spots, 2), fold)
    evidence = np.where(twice, -np.inf, evidence.reshape(count, spots))
    first = np.flatnonzero(np.diff(places.press, prepend=-1))
    each = np.diff(first, append=spots)
    highest = np.maximum.reduceat(evidence, first, axis=1)
    chance = np.exp(evidence - np.repeat(highest, each, axis=1))
    mass = np.add.reduceat(chance, first, axis=1)
    chance /= np.repeat(mass, each, axis=1)
    total = (highest + np.log(mass)).sum(axis=1)
    return total - len(model.problem) * (2 * points[:, 5] + points[:, 6]), chance, state


def climb(model: PressModel, bounds: Bounds, start: Floats, *, sigmas: Floats | None = None) -> Peak:
    """From a grid point to the most probable point: Gauss-Newton over all variables, sigmas by expectation.

    Args:
        model: the presses, with tables that span the neighbourhood.
        bounds: box of the macro variables.
        start: (5,) macro variables to start from.
        sigmas: (6,) of a peak nearby, where there is one; else they start wide, without shared errors, which finds
            the way from afar.
    """
    macro = np.clip(start, bounds.low, bounds.high)
    far = sigmas is None
    if sigmas is None:
        sigmas = far_sigmas(model.problem)
    damping, places = 1e-3, None
    searches = _SEARCHES_FAR if far else _SEARCHES_NEAR
    for step_number in range(STEPS):
        problem = model.problem
        if places is None or step_number in searches:
            places = find_places(model, macro, sigmas)
        here, states = _at(model, places, macro, sigmas)
        trust = trust_of(states)
        value = _value(problem, states, trust)
        gradient, curvature = _reduced(problem, states, trust, shared=not far)
        damped = curvature + np.diag(damping * np.diag(curvature) + 1e-9)
        step = -np.linalg.solve(damped, gradient)
        limit = np.array([0.5e-3, 0.5e-3, 0.1, 0.4, 0.2])
        step *= min(1.0, float((limit / np.maximum(np.abs(step[:5]), 1e-30)).min()))
        trial = np.clip(macro + step[:5], bounds.low, bounds.high)
        changed = (
            model if far else replace(model, problem=problem.with_shared(problem.shared.theta + step[5:]))
        )
        there, tried = _at(changed, here, trial, sigmas)
        if _value(changed.problem, tried, trust) <= value + 1e-9:
            converged = (np.abs(trial - macro) / limit).max() < 1e-4 and step_number > searches[-1]
            macro, damping, model = trial, damping * 0.2, changed
            places, states = there, tried
        else:
            converged, damping = False, max(damping, 1e-4) * 10
        known = None if far else np.diag(_inverse(curvature))[5:]
        told = estimated_sigmas(model.problem, states, sigmas, known)
        step = np.log(told / sigmas)
        # Expectation-maximisation closes in on the sigmas by a quarter a step; beyond its point it goes faster.
        sigmas = sigmas * np.exp(step if far and step_number <= _WIDE else _BEYOND * step)
        sigmas[2] = max(sigmas[2], model.problem.observation.floor_counts * 1.05)
        if converged and np.abs(step).max() < _SIGMAS_REST:
            break
    assert places is not None
    return _peak(model, bounds, macro, sigmas, places)


def _peak(model: PressModel, bounds: Bounds, macro: Floats, sigmas: Floats, places: Places) -> Peak:
    """The peak where a climb ended, told with gains whose mean over the taxels is one."""
    theta, alive = model.problem.shared.theta.copy(), np.flatnonzero(model.problem.alive)
    mean = float(theta[alive].mean()) if len(alive) else 0.0
    theta[alive] -= mean
    macro, problem = macro + mean * np.array([0.0, 0.0, 0.0, 0.0, 1.0]), model.problem.with_shared(theta)
    model = replace(model, problem=problem)
    places, states = _at(model, places, macro, sigmas)
    _, curvature = _reduced(problem, states, trust_of(states))
    # What the presses do not tell is still known to lie in the box: as well as an even spread over it.
    curvature[range(5), range(5)] += 12.0 / (bounds.high - bounds.low) ** 2
    way = block_diag(np.eye(5), problem.shared.directions(problem.alive))
    covariance = _inverse(way.T @ curvature @ way)
    point = np.concatenate([macro, np.log(sigmas)])[None]
    density = float(log_posterior(model, places, bounds, point)[0])
    return Peak(macro, sigmas, theta, covariance[:5, :5], places, states, density)


def _at(model: PressModel, places: Places, macro: Floats, sigmas: Floats) -> tuple[Places, PressStates]:
    """Where presses settle at one macro point, and each press at its best place."""
    state = model.settle_at(places, macro[None], sigmas[None], iterations=6)
    score = state.objective - 2 * half_inverse(state.hessian)[1]
    return state.places, state.some(best_of_each(places.press, score, len(model.problem)))


def _value(problem: FitProblem, state: PressStates, trust: Floats) -> float:
    """Q of all presses and of what they share, each press as it is trusted."""
    precision = problem.shared.precision(state.sigmas[:1, 4], state.sigmas[:1, 5])[0]
    return float(trust @ state.objective + (precision * problem.shared.theta**2).sum())


def _reduced(
    problem: FitProblem, state: PressStates, trust: Floats, *, shared: bool = True
) -> tuple[Floats, Floats]:
    """Gradient (5 + T,) and Hessian of Q/2 by macro variables and, if they are free, shared errors."""
    gradient, curvature = (array[0] for array in eliminated(problem.shared, state, trust[None], macro=True))
    if not shared:
        return gradient[:5], curvature[:5, :5]
    precision = problem.shared.precision(state.sigmas[:1, 4], state.sigmas[:1, 5])[0]
    gradient[5:] += precision * problem.shared.theta
    curvature[range(5, len(curvature)), range(5, len(curvature))] += precision
    return gradient, (curvature + curvature.T) / 2


def _inverse(matrix: Floats) -> Floats:
    """The inverse of a positive matrix whose rows have different units; directions it does not hold stay at zero."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.linalg.pinv(matrix * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
