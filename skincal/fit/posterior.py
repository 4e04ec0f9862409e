"""The joint posterior of the macro variables, with positions, forces and noise integrated out.

On the grid each press is placed by its normalised image. The ratios of two or three taxels do not tell a whole place,
so there the loss stays far above the noise of good data, and its least point is off. From the best grid points on, the
fit therefore goes on continuously, with the likelihood of the absolute images: the slack of each press is Gaussian
(sigma_p), so is the error of its force (sigma_f), and the residual of the images (sigma_n). All three sigmas are
estimated from the data along with the macro variables, so that intervals widen by themselves on a rig that is worse
than it says, and where the model does not quite fit. Integrals over slack and force are Laplace's, summed over all
places that a press could have been; the macro variables and the sigmas are sampled in :mod:`skincal.fit.sampling`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from skincal.fit.places import Places, find_places, mirrored, settled_twice, starting_nuisance
from skincal.fit.presses import PressStates, settle
from skincal.fit.problem import FitProblem
from skincal.fit.seen import Images
from skincal.fit.types import Floats, Ints
from skincal.fit.volume import fold_of, log_volume

MIN_NOISE = 0.03
SETTLE = 12
FORCE_SIGMA, FORCE_SPREAD = 0.005, 1.0
POSITION_SPREAD = 0.6
_TRUSTED = 16.0
"""A press whose mean square is more than this many times the usual is trusted less."""

_SEARCHES_FAR, _SEARCHES_NEAR = (3, 6, 10, 15), (2, 5)
"""Steps of a climb before which places are searched anew: from afar, and from a peak nearby."""
_WIDE, _BEYOND, _SIGMAS_REST = 6, 1.6, 5e-3
"""So many steps the sigmas only follow; then they go so much further than told, until they change by no more."""

_UNITS = np.array([1e3, 1e3, 1.0, 1.0, 1.0])
NOISE_SPREAD = 0.2
"""How far, in its logarithm, the residual of the best images may be from the noise that untouched taxels tell.

Few images say more than what finds their press, so a wider prior is not narrowed by the data, and too large a noise
makes presses that lie over the middle of a taxel pull the scale down.
"""


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
        sigmas: (3,) sigma_p [m], sigma_f, sigma_n [counts].
        covariance: (5, 5) of the macro variables, Laplace.
        places: where each press could have been, seen from here.
        best: (K,) index into ``places`` of each press's best place.
        states: the presses at their best places.
        log_density: unnormalised log posterior.
    """

    macro: Floats
    sigmas: Floats
    covariance: Floats
    places: Places
    best: Ints
    states: PressStates
    log_density: float

    @property
    def log_evidence(self) -> float:
        """Logarithm of the mass under the peak (Laplace), up to a constant."""
        # Millimetres and the like keep the determinant away from underflow; a constant factor does not matter.
        scaled = self.covariance * np.outer(_UNITS, _UNITS)
        return self.log_density + 0.5 * float(np.linalg.slogdet(scaled)[1])


def log_posterior(
    problem: FitProblem, images: Images, places: Places, bounds: Bounds, points: Floats
) -> Floats:
    """Unnormalised log posterior (W,) of points (W, 8): five macro variables and three log sigmas."""
    inside = ((points[:, :5] >= bounds.low) & (points[:, :5] <= bounds.high)).all(axis=1)
    inside &= points[:, 7] > np.log(MIN_NOISE)
    out = np.full(len(points), -np.inf)
    if not inside.any():
        return out
    chosen = points[inside]
    count, spots = len(chosen), len(places.press)
    macro = np.repeat(chosen[:, :5], spots, axis=0)
    sigmas = np.repeat(np.exp(chosen[:, 5:]), spots, axis=0)
    press = np.tile(places.press, count)
    start = starting_nuisance(problem, places, macro, press, count)
    state = settle(problem, images, macro, sigmas, press, start, iterations=SETTLE)
    fold = fold_of(problem, images, macro, sigmas, press, state)
    paired = mirrored(places.press, state.nuisance[:, :2], fold.mirror_m, count)
    evidence = -0.5 * state.objective + log_volume(fold, paired)
    twice = settled_twice(places.press, state.uv_m.reshape(count, spots, 2), fold)
    evidence = np.where(twice, -np.inf, evidence.reshape(count, spots))
    total = np.zeros(count)
    for k in range(len(problem)):
        total += logsumexp(evidence[:, places.press == k], axis=1)
    log_sigma = chosen[:, 5:]
    lit = float(problem.lit.sum())
    total -= len(problem) * (2 * log_sigma[:, 0] + log_sigma[:, 1]) + lit * log_sigma[:, 2]
    out[inside] = total + _log_prior(problem, log_sigma)
    return out


def _log_prior(problem: FitProblem, log_sigma: Floats) -> Floats:
    """Of the sigmas; flat in the macro variables (E and S by their logarithm) and in the log of the noise."""
    position = (log_sigma[:, 0] - np.log(_position_scale(problem))) / POSITION_SPREAD
    force = (log_sigma[:, 1] - np.log(FORCE_SIGMA)) / FORCE_SPREAD
    noise = (log_sigma[:, 2] - np.log(problem.noise_sigma_counts)) / NOISE_SPREAD
    return -0.5 * (position**2 + force**2 + noise**2)


def _position_scale(problem: FitProblem) -> float:
    sigma = problem.rig.position_sigma_m
    return sigma if np.isfinite(sigma) and sigma > 0 else problem.rig.slack_m


def climb(
    problem: FitProblem,
    images: Images,
    bounds: Bounds,
    start: Floats,
    *,
    sigmas: Floats | None = None,
    iterations: int = 25,
) -> Peak:
    """From a grid point to the most probable point: Gauss-Newton over all variables, sigmas by expectation.

    Args:
        problem: the presses.
        images: kernels that span the neighbourhood.
        bounds: box of the macro variables.
        start: (5,) macro variables to start from.
        sigmas: (3,) of a peak nearby, where there is one; else they start wide, which finds the way from afar.
        iterations: at most so many steps; places are searched anew a few times on the way.
    """
    macro = np.clip(start, bounds.low, bounds.high)
    far = sigmas is None
    if sigmas is None:
        sigmas = np.array([_position_scale(problem) * 0.7, 0.01, 1.5])
    damping, places = 1e-3, None
    searches = _SEARCHES_FAR if far else _SEARCHES_NEAR
    for step_number in range(iterations):
        if places is None or step_number in searches:
            places = find_places(problem, images, macro, sigmas)
        states, best = _at(problem, images, places, macro, sigmas)
        trust = _trust(problem, states, best)
        value = float(trust @ states.objective[best])
        gradient, curvature = _reduced(states, best, sigmas, trust)
        step = -np.linalg.solve(curvature + np.diag(damping * np.diag(curvature) + 1e-9), gradient)
        limit = np.array([0.5e-3, 0.5e-3, 0.1, 0.4, 0.2])
        step *= min(1.0, float((limit / np.maximum(np.abs(step), 1e-30)).min()))
        trial = np.clip(macro + step, bounds.low, bounds.high)
        tried, tried_best = _at(problem, images, _moved(places, states), trial, sigmas)
        trial_value = float(trust @ tried.objective[tried_best])
        if trial_value <= value + 1e-9:
            converged = (np.abs(trial - macro) / limit).max() < 1e-4 and step_number > searches[-1]
            macro, damping, states, best = trial, damping * 0.2, tried, tried_best
            places = _moved(places, states)
        else:
            converged, damping = False, max(damping, 1e-4) * 10
        step = np.log(_estimated_sigmas(problem, states, best, sigmas) / sigmas)
        # Expectation-maximisation closes in on the sigmas by a quarter a step; beyond its point it goes faster.
        sigmas = sigmas * np.exp(step if far and step_number <= _WIDE else _BEYOND * step)
        sigmas[2] = max(sigmas[2], MIN_NOISE * 1.05)
        if converged and np.abs(step).max() < _SIGMAS_REST:
            break
    assert places is not None
    states, best = _at(problem, images, places, macro, sigmas)
    _, curvature = _reduced(states, best, sigmas, _trust(problem, states, best))
    point = np.concatenate([macro, np.log(sigmas)])[None]
    density = float(log_posterior(problem, images, _moved(places, states), bounds, point)[0])
    chosen = PressStates(*(array[best] for array in vars(states).values()))
    return Peak(macro, sigmas, np.linalg.pinv(curvature), _moved(places, states), best, chosen, density)


def _moved(places: Places, states: PressStates) -> Places:
    return Places(places.press, states.uv_m.copy(), states.nuisance[:, 2].copy())


def _at(
    problem: FitProblem, images: Images, places: Places, macro: Floats, sigmas: Floats
) -> tuple[PressStates, Ints]:
    """Presses settled at one macro point, and the best place of each press."""
    count = len(places.press)
    many = np.broadcast_to(macro, (count, 5)).copy()
    start = starting_nuisance(problem, places, many, places.press, 1)
    state = settle(
        problem, images, many, np.broadcast_to(sigmas, (count, 3)).copy(), places.press, start, iterations=6
    )
    score = state.objective + np.linalg.slogdet(state.hessian)[1]
    best = [
        int(rows[np.argmin(score[rows])])
        for rows in (np.flatnonzero(places.press == k) for k in range(len(problem)))
    ]
    return state, np.array(best, dtype=np.intp)


def _mean_squares(problem: FitProblem, state: PressStates, rows: Ints) -> Floats:
    """Mean squared residual of each press over its lit taxels (K,) [counts²]."""
    squares = np.maximum((state.residual[rows] ** 2).sum(axis=1) - problem.dark_squares, 0.0)
    return squares / np.maximum(problem.lit.sum(axis=1), 1)


def _trust(problem: FitProblem, state: PressStates, rows: Ints) -> Floats:
    """Weight of each press (K,): less than one where it is matched far worse than the others."""
    squares = _mean_squares(problem, state, rows)
    typical = max(float(np.median(squares)), problem.noise_sigma_counts**2)
    return np.minimum(1.0, _TRUSTED * typical / np.maximum(squares, 1e-30))


def _reduced(state: PressStates, rows: Ints, sigmas: Floats, trust: Floats) -> tuple[Floats, Floats]:
    """Gradient (5,) and Hessian (5, 5) of the macro variables with the nuisance eliminated (Schur complement)."""
    noise = 1.0 / sigmas[2] ** 2
    a, b, r = state.macro_slope[rows], state.nuisance_slope[rows], state.residual[rows]
    prior = 1.0 / sigmas[[0, 0, 1]] ** 2
    mixed = noise * np.matmul(a.transpose(0, 2, 1), b)
    own = noise * np.einsum("njd,nj->nd", b, r) + prior * state.nuisance[rows]
    inverse = np.linalg.inv(state.hessian[rows])
    gradient = noise * np.einsum("njm,nj->nm", a, r) - np.einsum("nmd,nde,ne->nm", mixed, inverse, own)
    curvature = noise * np.einsum("njm,njl->nml", a, a) - np.einsum("nmd,nde,nle->nml", mixed, inverse, mixed)
    return trust @ gradient, np.einsum("n,nml->ml", trust, curvature)


def _estimated_sigmas(problem: FitProblem, state: PressStates, rows: Ints, sigmas: Floats) -> Floats:
    """One step of expectation-maximisation for the sigmas, with the priors of :func:`_log_prior`.

    A press that fits far worse than the others counts no more than the bound of :func:`_trust`.
    """
    inverse = np.linalg.inv(state.hessian[rows])
    second = state.nuisance[rows] ** 2 + np.einsum("nii->ni", inverse)
    second = np.minimum(second, _TRUSTED * np.median(second, axis=0))
    position = _shrunk(second[:, :2].sum(), second[:, :2].size, _position_scale(problem), POSITION_SPREAD)
    force = _shrunk(second[:, 2].sum(), len(second), FORCE_SIGMA, FORCE_SPREAD)
    slope = state.nuisance_slope[rows]
    explained = float(np.einsum("njd,nde,nje->", slope, inverse, slope))
    found = _mean_squares(problem, state, rows)
    capped = np.minimum(found, _TRUSTED * max(float(np.median(found)), problem.noise_sigma_counts**2))
    squares = float((capped * problem.lit.sum(axis=1)).sum()) + explained
    noise = _shrunk(squares, int(problem.lit.sum()), problem.noise_sigma_counts, NOISE_SPREAD)
    return np.array([position, force, max(noise, MIN_NOISE * 1.05)])


def _shrunk(squares: float, count: int, centre: float, spread: float) -> float:
    """Maximum of the posterior of a sigma with a log-normal prior: a few Newton steps in its logarithm."""
    x = 0.5 * np.log(squares / count)
    for _ in range(20):
        slope = -count + squares * np.exp(-2 * x) - (x - np.log(centre)) / spread**2
        x += slope / (2 * squares * np.exp(-2 * x) + 1 / spread**2)
    return float(np.exp(x))
