"""The selection probability: a press is fitted because of its readings, and the likelihood has to account for that.

A press with too few active taxels is left out. A stiff skin loses more presses this way than a soft one, and
those that remain have wider images than usual. The likelihood of a press is therefore the density of its
readings *among presses that are taken*,

    p(y | taken, m) = p(y | m) / P(taken | m),    P(taken | m) = sum_s w_s P(enough taxels active | m, slack s),

with slacks s on a lattice that represents their normal distribution. Without the denominator E is biased low,
by half of its standard deviation. The probability is a smooth function of the parameters, so it is evaluated
for some of the draws only (:func:`skincal.fitting.sampling.smooth_term`).
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from skincal.fitting.lattice import disc
from skincal.fitting.presses import PressModel
from skincal.fitting.types import Floats, Ints

SPACING, REACH = 0.75, 2.7
"""Step and extent of the lattice of slacks, in standard deviations of the slack."""

CERTAIN = 1e-3
"""A press that is not taken with less than this probability counts as certain for all parameters."""


def log_selection_probability(model: PressModel, points: Floats) -> Floats:
    """Return the log probability (W,) that all presses of a problem are taken.

    Args:
        model: the presses, with the threshold and number of active taxels required.
        points: (W, 11) macro variables and logs of the sigmas.
    """
    every = np.arange(len(model.problem))
    uncertain = np.flatnonzero(_taken_probabilities(model, points.mean(axis=0), every) < 1 - CERTAIN)
    return np.array([np.log(_taken_probabilities(model, p, uncertain)).sum() for p in points])


def _taken_probabilities(model: PressModel, point: Floats, press: Ints) -> Floats:
    """Return the probability (n,) that each of some presses (n,) is taken, at one point (11,)."""
    # Lattice in standard deviations of the slack, and the weight of each node. The order matters for
    # rounding: a press that is hardly ever taken has a probability that is what rounding leaves of a sum.
    problem, lattice = model.problem, disc(SPACING, REACH)[:, ::-1]
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
    cell = (SPACING * sigmas[0]) ** 2 / 12 * (slope[..., :2] ** 2).sum(axis=2)
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
