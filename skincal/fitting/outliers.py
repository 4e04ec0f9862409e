"""Outlier presses, dropped readings and dead taxels, which must not bias a fit."""

from __future__ import annotations

import numpy as np

from skincal.fitting.posterior import Peak
from skincal.fitting.presses import PressStates
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Bools
from skincal.statistics import robust_sigma

MAX_GLITCHES = 0.2
"""At most this fraction of the presses counts as outliers; beyond it the model is wrong, not the presses."""

LOST_SIGMAS, LOST_TIMES, MOST_LOST = 5.0, 8.0, 0.03
"""A reading counts as dropped if it is this many standard deviations below the model, and this multiple of the
typical residual. If more than the third number (a fraction) are, the model is wrong, not the readings."""

SILENT = 0.2
"""A taxel whose signal is less than this fraction of the expected one is dead."""

PRESSED = 0.07
"""A taxel is pressed if the model gives it this fraction of the typical largest signal."""


def find_outlier_presses(problem: FitProblem, peak: Peak) -> Bools:
    """Return presses (K,) whose image or force is far from what the other presses agree on."""
    states = peak.states
    rms = np.sqrt((states.residual**2).sum(axis=1) / np.maximum((problem.used).sum(axis=1), 1))
    typical = max(float(np.median(rms)), 1.0)
    force = states.nuisance[:, 2]
    usual_force = max(robust_sigma(force, 0.0), 0.005)
    odd = (rms > 6.0 * typical) | (np.abs(force) > np.maximum(8.0 * usual_force, 0.08))
    allowed = int(MAX_GLITCHES * len(problem))
    if odd.sum() > allowed:
        return np.zeros(len(problem), dtype=bool)
    return odd


def find_dropped_readings(problem: FitProblem, states: PressStates, gain_sigma: float) -> Bools:
    """Return single readings (K, J) that are far below what the others of their press imply: a taxel dropped out.

    Args:
        problem: the presses.
        states: presses at their best positions, without gains.
        gain_sigma: relative spread of the taxels' gains; a deficit that it explains is no drop-out.
    """
    used = problem.used
    typical = robust_sigma(states.residual[used], 0.0) if used.any() else 0.0
    below = states.residual / np.hypot(1.0, gain_sigma * states.macro_slope[..., 4])
    odd = used & (states.residual > LOST_TIMES * typical) & (below > LOST_SIGMAS)
    # If more than half of a press's lit taxels are off, the press is the outlier.
    odd &= (odd & problem.lit).sum(axis=1, keepdims=True) * 2 <= problem.lit.sum(axis=1, keepdims=True)
    if odd.sum() > MOST_LOST * used.sum():
        return np.zeros_like(odd)
    return np.asarray(odd, dtype=np.bool_)


def find_weak_taxels(problem: FitProblem) -> Bools:
    """Return taxels (J,) whose largest reading is far below the others': dead ones, and some that nothing presses.

    A climb from afar leaves them out: a dead taxel that is taken for alive biases everything else.
    """
    largest = np.where(problem.used, problem.values, 0.0).max(axis=0, initial=0.0)
    alive = problem.used.any(axis=0)
    usual = float(np.median(largest[alive])) if alive.any() else 0.0
    return np.asarray(alive & (largest < SILENT * usual), dtype=np.bool_)


def find_dead_taxels(problem: FitProblem, states: PressStates) -> Bools:
    """Return taxels (J,) that stay silent, or never leave one level, although the model says that they are pressed."""
    simulated, observed = states.simulated, problem.values
    pressed = (simulated > PRESSED * problem.observation.typical_counts) & (problem.used)
    enough = pressed.sum(axis=0) >= 3
    gain = (simulated * observed * pressed).sum(axis=0) / np.maximum(
        (simulated**2 * pressed).sum(axis=0), 1e-12
    )
    return enough & (gain < SILENT)
