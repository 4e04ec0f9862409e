"""The terms of the log posterior that are too expensive for every draw, and smooth enough for a few to do.

The evidence of presses where the Laplace approximation is off, over the middle of a taxel or on a ring around
it: a Gaussian slack prior is a mixture of narrower ones on a lattice, within which the image hardly bends,

    N(s; 0, sigma_p²) = sum_c h² N(c; 0, sigma_p² - omega²) N(s; c, omega²),

accurate to 3e-4 for h = 1.5 omega. And the selection of presses, as those with too few active taxels are left
out: the likelihood is the density of a press's readings among presses that are taken,

    p(y | taken, m) = p(y | m) / P(taken | m),    P(taken | m) = sum_s w_s P(enough taxels active | m, slack s),

with slacks s on a lattice that represents their normal distribution. Without either, E is biased by half of its
standard deviation. A smooth function that is fitted to the values at some draws is added to all
(:func:`skincal.fitting.sampling.smooth_term`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from skincal.fitting.laplace import measure_fold, sum_by_press
from skincal.fitting.lattice import disc
from skincal.fitting.presses import Places, PressModel, PressStates, factor_inverse
from skincal.fitting.types import Floats, Ints

NARROW_SPACING = 1.5
"""Distance of the narrow priors in units of their standard deviation; the mixture is then even to 3e-4."""

BEND = 0.3
"""Bend of the whitened residual within a narrow prior. The slope of a session's log evidence by log E is then
within 3 of the one for half of this value, a tenth of a standard deviation; with twice this value it is off
by 7."""

WIDEST, NARROWEST = 0.6, 0.06
"""Largest and smallest standard deviation of the narrow priors, relative to the full one."""

NARROW_REACH = 3.3
"""Extent of the lattice, in standard deviations of the slack."""

MARGIN = 7.0
"""Narrow priors whose log evidence is this much below the best one of the press are ignored."""

_STEPS = 4
"""Most full Gauss-Newton steps in a narrow prior."""
_STEP = 0.3
"""Step of the finite difference for the bend of the residual, relative to the narrow prior."""
_FLATTEST = 0.1
"""Least eigenvalue of the full Hessian relative to the Gauss-Newton Hessian; below it, the latter is used."""

SELECTION_SPACING, SELECTION_REACH = 0.75, 2.7
"""Step and extent of the lattice of slacks, in standard deviations of the slack."""

CERTAIN = 1e-3
"""A press that is not taken with less than this probability counts as certain for all parameters."""


@dataclass(frozen=True, eq=False)
class NarrowSlacks:
    """The narrow slack priors (N,) of all presses that are not ignored.

    Attributes:
        at: position of the press within each, at the macro point for which they were found.
        centre_m: (N, 2) mean of each [m].
        omega_m: (N,) its standard deviation [m].
    """

    at: Places
    centre_m: Floats
    omega_m: Floats


def find_narrow_slacks(model: PressModel, places: Places, macro: Floats, sigmas: Floats) -> NarrowSlacks:
    """Find the narrow slack priors that matter at one macro point (5,) and sigmas (6,)."""
    bend = _residual_bends(model, places, macro, sigmas)
    omega = np.clip(
        np.sqrt(BEND / np.maximum(bend, 1e-30)), NARROWEST * sigmas[0], WIDEST * sigmas[0]
    ).tolist()
    found = [_find_in_press(model, macro, sigmas, k, one) for k, one in enumerate(omega)]
    press, centre, width, uv, force = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    return NarrowSlacks(Places(press, uv, force), centre, width)


def _find_in_press(
    model: PressModel, macro: Floats, sigmas: Floats, k: int, omega_m: float
) -> tuple[Ints, Floats, Floats, Floats, Floats]:
    """Return the narrow priors of press ``k`` that matter; one press at a time, to bound memory."""
    lattice = disc(NARROW_SPACING * omega_m, NARROW_REACH * float(sigmas[0]))
    press, width = np.full(len(lattice), k, dtype=np.intp), np.full(len(lattice), omega_m)
    start = np.column_stack([lattice + model.problem.shared.shift_m[press], np.zeros(len(press))])
    evidence, at = _evidence(model, macro, sigmas, press, lattice, width, start)
    kept = evidence > evidence.max() - MARGIN
    return press[kept], lattice[kept], width[kept], at.uv_m[kept], at.nuisance[kept, 2]


def _residual_bends(model: PressModel, places: Places, macro: Floats, sigmas: Floats) -> Floats:
    """Return the second derivative (K,) of the whitened residuals by position [1/m²], about the largest."""
    state = model.fit_at_places(places, macro[None], sigmas[None])
    weak = 2.0 * measure_fold(model, state).half_bend
    bend = np.zeros(len(model.problem))
    np.maximum.at(bend, places.press, weak)
    # If the residual is straight along the weakest direction, another direction bends on the scale of a
    # taxel's size.
    observation, size = model.problem.observation, float(np.median(model.problem.rig.layout.sizes_m))
    spread = np.sqrt(observation.variance(state.sigmas[:, 2], state.sigmas[:, 3], places.press))
    np.maximum.at(bend, places.press, (state.simulated / spread).max(axis=1) / size**2)
    return bend


def log_evidence(model: PressModel, slacks: NarrowSlacks, points: Floats) -> Floats:
    """Return the log evidence (W,) of all presses, comparable to :func:`skincal.fitting.posterior.press_evidence`."""
    press, evidence = slacks.at.press, list[Floats]()
    for point in points:
        macro, sigmas = point[:5], np.exp(point[5:])
        start = model.nuisance_at(slacks.at, np.tile(macro, (len(press), 1)))
        evidence.append(_evidence(model, macro, sigmas, press, slacks.centre_m, slacks.omega_m, start)[0])
    return sum_by_press(press, np.array(evidence))[0]


def _evidence(
    model: PressModel,
    macro: Floats,
    sigmas: Floats,
    press: Ints,
    centre_m: Floats,
    omega_m: Floats,
    start: Floats,
) -> tuple[Floats, PressStates]:
    """Return the log evidence (N,) of narrow priors at one macro point, and the presses fitted in them."""
    spreads = np.tile(sigmas, (len(press), 1))
    left = np.maximum(sigmas[0] ** 2 - omega_m**2, (0.1 * sigmas[0]) ** 2)
    spreads[:, 0] = omega_m
    centre = centre_m + model.problem.shared.shift_m[press]
    state = model.fit_nuisance(macro, spreads, press, start, iterations=_STEPS, to_rest=False, centre=centre)
    weight = -0.5 * (centre_m**2).sum(axis=1) / left - np.log(left) - np.log(sigmas[1])
    return -0.5 * state.objective + factor_inverse(_full_hessian(model, state))[1] + weight, state


def _full_hessian(model: PressModel, state: PressStates) -> Floats:
    """Return Hessians (n, 3, 3) of fitted presses with the residual terms that Gauss-Newton omits.

    If a press reads more or less than its position can give, a residual is left, and the bend of the image
    adds to the curvature. Over the middle of a taxel, this term has the same sign for all presses.
    """
    step = _STEP * state.sigmas[:, 0]
    added = np.zeros_like(state.hessian)
    for d in range(2):
        away = np.zeros_like(state.nuisance)
        away[:, d] = step
        bend = model.bends(state, away) / (2 * step)[:, None, None]
        added[:, d] = np.einsum("nj,njd->nd", state.residual, bend)
    added[:, 2, :2] = added[:, :2, 2]
    added[:, 0, 1] = added[:, 1, 0] = 0.5 * (added[:, 0, 1] + added[:, 1, 0])
    # Signals grow as exp(f).
    added[:, 2, 2] = np.einsum("nj,nj->n", state.residual, state.nuisance_slope[..., 2])
    whole = state.hessian + added
    # If the peak is too flat, the Laplace approximation fails anyway; keep the Gauss-Newton Hessian.
    size = np.sqrt(np.einsum("nii->ni", state.hessian))
    sound = np.linalg.eigvalsh(whole / (size[:, :, None] * size[:, None, :]))[:, 0] > _FLATTEST
    return np.where(sound[:, None, None], whole, state.hessian)


def log_selection_probability(model: PressModel, points: Floats) -> Floats:
    """Return the log probability (W,) that all presses are taken, at points (W, 11)."""
    every = np.arange(len(model.problem))
    uncertain = np.flatnonzero(_taken_probabilities(model, points.mean(axis=0), every) < 1 - CERTAIN)
    return np.array([np.log(_taken_probabilities(model, p, uncertain)).sum() for p in points])


def _taken_probabilities(model: PressModel, point: Floats, press: Ints) -> Floats:
    """Return the probability (n,) that each of some presses (n,) is taken, at one point (11,)."""
    # Lattice in standard deviations of the slack, and the weight of each node. The order matters for
    # rounding: a press that is hardly ever taken has a probability that is what rounding leaves of a sum.
    problem, lattice = model.problem, disc(SELECTION_SPACING, SELECTION_REACH)[:, ::-1]
    weight = np.exp(-0.5 * (lattice**2).sum(axis=1))
    weight /= weight.sum()
    sigmas, each = np.exp(point[5:]), np.repeat(press, len(weight))
    nuisance = np.zeros((len(each), 3))
    # Image tables of the general way only cover the declared slack.
    nuisance[:, :2] = np.clip(
        problem.shared.shift_m[each] + sigmas[0] * np.tile(lattice, (len(press), 1)),
        -problem.rig.slack_m,
        problem.rig.slack_m,
    )
    state = model.evaluate(point[:5], sigmas, each, nuisance)
    signal = state.simulated
    # Noise of a reading, plus the variation of the signal within a cell of the lattice.
    own = np.sqrt(problem.observation.variance(state.sigmas[:, 2], state.sigmas[:, 3], each))
    slope = state.nuisance_slope * own[..., None]
    cell = (SELECTION_SPACING * sigmas[0]) ** 2 / 12 * (slope[..., :2] ** 2).sum(axis=2)
    spread = np.sqrt(sigmas[2] ** 2 + (sigmas[3] ** 2 + sigmas[1] ** 2) * signal**2 + cell)
    above = (signal + problem.shared.level - problem.active_above) / spread
    active: Floats = np.asarray(ndtr(above), dtype=np.float64)
    short = _probability_of_fewer(np.where(problem.used[each], active, 0.0), problem.min_active)
    taken = 1.0 - short.reshape(len(press), len(weight)) @ weight
    return np.maximum(taken, np.finfo(float).tiny)


def _probability_of_fewer(active: Floats, least: int) -> Floats:
    """Return the probability (n,) that fewer than ``least`` of independent taxels (n, J) are active."""
    many = np.zeros((len(active), max(least, 1)))
    many[:, 0] = 1.0
    for one in active.T[:, :, None]:
        more = many[:, :-1] * one
        many *= 1.0 - one
        many[:, 1:] += more
    return many.sum(axis=1) if least > 0 else np.zeros(len(active))
