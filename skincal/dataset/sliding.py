"""How far a contact moves while it is held. Pure numerics."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SMALLEST_M: Final = 1e-4
"""A contact that moves less than this rests, however well its position is known [m]."""

SMOOTHED, PARTS = 5, 8
"""Positions are smoothed over so many samples, and no more than this part of the hold."""

NOISE_SIGMAS: Final = 5.0
"""What noise alone makes of the extent of a smoothed path at most, in its standard deviations (simulated: 4.6 in 1 of
1000 holds of 50 samples)."""


def slide_m(position_m: FloatArray) -> float:
    """How far a contact moves in its hold [m], noise of the positions left out; NaN where they are not known.

    Args:
        position_m: sample by sample, shape (n, 3).
    """
    path, noise = _path(position_m)
    if len(path) < 2:
        return float("nan")
    return max(float(np.linalg.norm(np.ptp(path, axis=0))) - NOISE_SIGMAS * noise, 0.0)


def rests(position_m: FloatArray, still_m: float) -> tuple[int, int]:
    """The longest stretch ``[start, stop)`` of a hold in which the contact moves no farther than ``still_m``.

    Args:
        position_m: sample by sample, shape (n, 3).
        still_m: how far a contact that rests moves [m].
    """
    path, noise = _path(position_m)
    allowed = still_m + NOISE_SIGMAS * noise
    width = len(position_m) - len(path) + 1
    best, start = (0, 0), 0
    for stop in range(1, len(path) + 1):
        while np.linalg.norm(np.ptp(path[start:stop], axis=0)) > allowed:
            start += 1
        if stop - start > best[1] - best[0]:
            best = start, stop
    return best[0], best[1] + width - 1 if best[1] else 0


def _path(position_m: FloatArray) -> tuple[FloatArray, float]:
    """Smoothed positions (m, 3), and the standard deviation of their noise [m]; empty where they are not known."""
    if len(position_m) < 2 or not np.isfinite(position_m).all():
        return np.zeros((0, 3)), 0.0
    width = max(1, min(SMOOTHED, len(position_m) // PARTS))
    # Differences of neighbours are of the noise alone: a slide is slow.
    apart = np.diff(position_m, axis=0)
    sigma = float(
        np.linalg.norm(1.4826 * np.median(np.abs(apart - np.median(apart, axis=0)), axis=0))
    ) / np.sqrt(2)
    total = np.cumsum(np.vstack([np.zeros(3), position_m]), axis=0)
    return (total[width:] - total[:-width]) / width, sigma / np.sqrt(width)
