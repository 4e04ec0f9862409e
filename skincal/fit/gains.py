"""A scale for every taxel: S_j = S exp(g_j), found with the positions and forces of all presses left free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.fit.presses import settle, solve_small
from skincal.fit.problem import FitProblem
from skincal.fit.seen import Images
from skincal.fit.types import Floats, Ints

GAIN_SPREAD = 0.1
"""Taxels of one sensor are taken to differ by ten percent (one sigma); the data decide where they say enough."""

_ROUNDS = 6


def taxel_gains(
    problem: FitProblem, images: Images, macro: Floats, sigmas: Floats, press: Ints, nuisance: Floats
) -> Floats:
    """Logarithms of each taxel's scale over the common one (J,).

    Gauss-Newton over the gains, the nuisance of every press eliminated (Schur complement), the macro variables fixed.

    Args:
        problem: the presses.
        images: kernels round the best point.
        macro: (5,) macro variables.
        sigmas: (3,) sigma_p [m], sigma_f, sigma_n [counts].
        press: (K,) number of every press.
        nuisance: (K, 3) slack and force error to start from.
    """
    count, taxels = len(press), problem.rig.layout.taxels
    many, wide = np.tile(macro, (count, 1)), np.tile(sigmas, (count, 1))
    gains: Floats = np.zeros(taxels, dtype=np.float64)
    state_at = nuisance
    noise = 1.0 / sigmas[2] ** 2
    for _ in range(_ROUNDS):
        # Residuals of S_j = S exp(g_j) are those of S with values divided, and weights multiplied, by exp(g_j).
        factor = np.exp(gains)
        scaled = replace(problem, values=problem.values / factor, weight=problem.weight * factor)
        state = settle(scaled, images, many, wide, press, state_at, iterations=12)
        state_at = state.nuisance
        slope = scaled.weight[press] * state.simulated
        inverse = np.linalg.inv(state.hessian)
        mixed = noise * slope[:, :, None] * state.nuisance_slope
        own = noise * np.einsum("njd,nj->nd", state.nuisance_slope, state.residual)
        own += state.nuisance / wide[:, [0, 0, 1]] ** 2
        gradient = noise * (slope * state.residual).sum(axis=0)
        gradient = gradient - np.einsum("njd,nde,ne->j", mixed, inverse, own) + gains / GAIN_SPREAD**2
        curvature = np.diag(noise * (slope**2).sum(axis=0) + 1.0 / GAIN_SPREAD**2)
        curvature = curvature - np.einsum("njd,nde,nle->jl", mixed, inverse, mixed)
        gains = gains - np.clip(solve_small(curvature[None], gradient[None])[0], -0.3, 0.3)
    return gains
