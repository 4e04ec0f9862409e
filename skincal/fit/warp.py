"""What a smooth error of the measured positions leaves open of the sensor's turn.

Joint offsets bend the field of measured positions: they err by nearly the same at neighbouring places, and to first
order by a constant and a gradient. The constant cannot be told from where the sensor sits. Of the gradient's four
numbers the images show three, two stretches and a shear; the fourth, a turn, cannot be told from alpha. Gradients of
no preferred kind have a turn as large as what shows, so that what shows says how far alpha can be off.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from skincal.fit.types import Floats

SURE = 0.01
"""Probability at which independent errors would show such a gradient; above it there is none."""

_FEWEST = 8

_NO_SPREAD_M = 1e-6
"""Presses that spread less lie at one place, or on a line along a direction."""


def turn_sigma(across_m: Floats, along_m: Floats, slack_m: Floats) -> float:
    """By how much the field of measured positions may be turned, one sigma [rad].

    Args:
        across_m: (K,) measured positions across [m].
        along_m: (K,) along the finger [m].
        slack_m: (K, 2) estimated less measured positions, across and along [m].

    Returns:
        g / sqrt(2), with g² the mean square of the two stretches and the shear, the last times sqrt(2), less what
        scatter makes of them; 0 where scatter explains them or presses are few.
    """
    if len(slack_m) < _FEWEST:
        return 0.0
    columns = np.stack([np.ones(len(across_m)), across_m - across_m.mean(), along_m - along_m.mean()], axis=1)
    normal = columns.T @ columns
    if np.diag(normal)[1:].min() < len(slack_m) * _NO_SPREAD_M**2:
        return 0.0
    if np.linalg.cond(normal / np.sqrt(np.outer(np.diag(normal), np.diag(normal)))) > 1e6:
        return 0.0
    inverse = np.linalg.inv(normal)
    gradient = inverse @ columns.T @ slack_m
    left = slack_m - columns @ gradient
    scatter = (left**2).sum(axis=0) / (len(slack_m) - 3)
    # Rows: by across, by along; columns: of the slack across, along.
    change, variance = gradient[1:], np.diag(inverse)[1:, None] * scatter
    shown = np.array([change[0, 0], change[1, 1], (change[0, 1] + change[1, 0]) / np.sqrt(2)])
    noise = np.maximum([variance[0, 0], variance[1, 1], (variance[0, 1] + variance[1, 0]) / 2], 1e-30)
    if chi2.sf(float((shown**2 / noise).sum()), 3) > SURE:
        return 0.0
    return float(np.sqrt(max(float((shown**2 - noise).mean()), 0.0) / 2))
