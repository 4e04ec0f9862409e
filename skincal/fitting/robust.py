"""Presses and taxels that must not sway a fit."""

from __future__ import annotations

import numpy as np

from skincal.fitting.posterior import Peak
from skincal.fitting.presses import PressStates
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Bools

MAX_GLITCHES = 0.2
"""At most this part of the presses is called a glitch; beyond it the model is wrong, not the presses."""

LOST_SIGMAS, LOST_TIMES, MOST_LOST = 5.0, 8.0, 0.03
"""A reading is lost that is so many standard deviations below the model, and so many times as far off as readings are;
of more than this part of them the model is wrong, not the readings."""

SILENT = 0.2
"""A taxel that shows less than this part of what it should does not answer."""

PRESSED = 0.07
"""A taxel is pressed where the model gives it this part of the usual largest signal."""


def glitches(problem: FitProblem, peak: Peak) -> Bools:
    """Single presses (K,) whose image or force is far from what all others agree on."""
    states = peak.states
    rms = np.sqrt((states.residual**2).sum(axis=1) / np.maximum((problem.used).sum(axis=1), 1))
    typical = max(float(np.median(rms)), 1.0)
    force = np.abs(states.nuisance[:, 2])
    usual_force = max(1.4826 * float(np.median(force)), 0.005)
    odd = (rms > 6.0 * typical) | (force > np.maximum(8.0 * usual_force, 0.08))
    allowed = int(MAX_GLITCHES * len(problem))
    if odd.sum() > allowed:
        return np.zeros(len(problem), dtype=bool)
    return odd


def lost_readings(problem: FitProblem, states: PressStates, gain_sigma: float) -> Bools:
    """Single readings (K, J) that are far below what all others of their press agree on: a taxel dropped out.

    Args:
        problem: the presses.
        states: presses at their best places, with no gains.
        gain_sigma: relative spread of the taxels' gains; what that explains is not lost.
    """
    used = problem.used
    typical = 1.4826 * float(np.median(np.abs(states.residual[used]))) if used.any() else 0.0
    below = states.residual / np.hypot(1.0, gain_sigma * states.macro_slope[..., 4])
    odd = used & (states.residual > LOST_TIMES * typical) & (below > LOST_SIGMAS)
    # Where most of a press's lit taxels are off, it is the press that does not fit.
    odd &= (odd & problem.lit).sum(axis=1, keepdims=True) * 2 <= problem.lit.sum(axis=1, keepdims=True)
    if odd.sum() > MOST_LOST * used.sum():
        return np.zeros_like(odd)
    return np.asarray(odd, dtype=np.bool_)


def weak_taxels(problem: FitProblem) -> Bools:
    """Taxels (J,) whose largest reading is far below those of the others: dead ones, and some that nothing presses.

    A climb from afar goes without them, as silence of a taxel that is thought alive bends everything else.
    """
    largest = np.where(problem.used, problem.values, 0.0).max(axis=0, initial=0.0)
    alive = problem.used.any(axis=0)
    usual = float(np.median(largest[alive])) if alive.any() else 0.0
    return np.asarray(alive & (largest < SILENT * usual), dtype=np.bool_)


def dead_taxels(problem: FitProblem, states: PressStates) -> Bools:
    """Taxels (J,) that stay silent, or never leave one level, where the model says that they are pressed."""
    simulated, observed = states.simulated, problem.values
    pressed = (simulated > PRESSED * problem.observation.typical_counts) & (problem.used)
    enough = pressed.sum(axis=0) >= 3
    gain = (simulated * observed * pressed).sum(axis=0) / np.maximum(
        (simulated**2 * pressed).sum(axis=0), 1e-12
    )
    return enough & (gain < SILENT)
