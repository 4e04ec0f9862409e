"""The chance that a press was taken: a press is fitted for what it read, and the likelihood has to know it.

A press with fewer active taxels than are asked for is left out. Of a stiff skin more are left out than of a soft one,
and of those that are left the images are wider than its usual ones. So what a press tells is the density of its
readings *among those of presses that are taken*,

    p(y | taken, m) = p(y | m) / P(taken | m),    P(taken | m) = sum_s w_s P(enough taxels active | m, slack s),

with the slacks s on a lattice that stands for their normal distribution. Without the denominator E comes out too low,
by half of its standard deviation. It is a smooth function of the parameters, so it is found for some of the draws only
(:func:`skincal.fitting.sampling.smooth_term`).
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from skincal.fitting.lattice import disc
from skincal.fitting.presses import PressModel
from skincal.fitting.types import Floats, Ints

SPACING, REACH = 0.75, 2.7
"""Lattice of slacks, and how far it goes, in standard deviations of the slack."""

CERTAIN = 1e-3
"""A press that is taken but for so small a chance is taken whatever the parameters are."""


def log_chance(model: PressModel, points: Floats) -> Floats:
    """Log chance (W,) that all presses of a problem were taken.

    Args:
        model: the presses, with what each had to read to be taken.
        points: (W, 11) macro variables and logarithms of the sigmas.
    """
    every = np.arange(len(model.problem))
    doubtful = np.flatnonzero(_chances(model, points.mean(axis=0), every) < 1 - CERTAIN)
    return np.array([np.log(_chances(model, p, doubtful)).sum() for p in points])


def _chances(model: PressModel, point: Floats, press: Ints) -> Floats:
    """Chance (n,) of each of some presses (n,) to be taken, at one point (11,)."""
    # Slacks in their standard deviation, and how much each stands for.
    # In this order, as the chance of a press that is hardly ever taken is what rounding leaves of a sum.
    problem, lattice = model.problem, disc(SPACING, REACH)[:, ::-1]
    weight = np.exp(-0.5 * (lattice**2).sum(axis=1))
    weight /= weight.sum()
    sigmas, each = np.exp(point[5:]), np.repeat(press, len(weight))
    nuisance = np.zeros((len(each), 3))
    # Tables of the general way go no further than the declared slack.
    nuisance[:, :2] = np.clip(
        problem.shared.shift_m[each] + sigmas[0] * np.tile(lattice, (len(press), 1)),
        -problem.rig.slack_m,
        problem.rig.slack_m,
    )
    state = model.evaluate(point[:5], sigmas, each, nuisance)
    signal = state.simulated
    # What a reading may be off by, and how far the signal changes from one point of the lattice to the next.
    own = np.sqrt(problem.observation.variance(state.sigmas[:, 2], state.sigmas[:, 3], each))
    slope = state.nuisance_slope * own[..., None]
    cell = (SPACING * sigmas[0]) ** 2 / 12 * (slope[..., :2] ** 2).sum(axis=2)
    spread = np.sqrt(sigmas[2] ** 2 + (sigmas[3] ** 2 + sigmas[1] ** 2) * signal**2 + cell)
    above = (signal + problem.shared.level - problem.active_above) / spread
    active: Floats = np.asarray(ndtr(above), dtype=np.float64)
    short = _fewer(np.where(problem.used[each], active, 0.0), problem.min_active)
    taken = 1.0 - short.reshape(len(press), len(weight)) @ weight
    return np.maximum(taken, np.finfo(float).tiny)


def _fewer(active: Floats, least: int) -> Floats:
    """Chance (n,) that fewer than ``least`` of independent taxels (n, J) are active."""
    many = np.zeros((len(active), max(least, 1)))
    many[:, 0] = 1.0
    for one in active.T[:, :, None]:
        more = many[:, :-1] * one
        many *= 1.0 - one
        many[:, 1:] += more
    return many.sum(axis=1) if least > 0 else np.zeros(len(active))
