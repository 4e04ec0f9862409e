"""Noise of a frame from frames in which nothing is pressed: many, but mostly at the converter's lower bound.

A count k is read where the value lies between k - 1/2 and k + 1/2, and the lowest and the highest count also hold all
that lies beyond. With Gaussian noise sigma about a level mu that is

    P(k) = Phi((k + 1/2 - mu) / sigma) - Phi((k - 1/2 - mu) / sigma).

Each taxel has a level of its own in each stretch of time, so that offsets and slow drifts do not pass for noise; sigma
is one for all, and the likelihood of the histograms is greatest at the estimate. A value at the bound says of sigma
about a fifth of what one far from it says. Histograms that pull at sigma harder than chance lets them are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import ndtr

from skincal.fit.observe import Readout
from skincal.model.arrays import BoolArray, FloatArray

STRETCH = 600
"""Frames of a stretch at least: over fewer, free levels would take scatter for themselves."""
_FEWEST = 300
_ENOUGH = 4000
"""Histograms that tell the noise to a few parts in a thousand; of more, stretches evenly through the session."""
_FAR = 4.0
"""Histograms so many times as wide as the median one are of no rest at all."""
_HARD = 4.0
"""Standard errors by which a histogram may pull at sigma: a glitch, a jump of the level, or a taxel that is not at rest
pulls harder, and its stretch is left out."""
_ROUNDS = 4
_STEPS = 30
_LEAST_SIGMA, _MOST_SIGMA = 0.05, 20.0
"""Sigmas that are looked at [counts]."""
_USELESS = 0.2
"""A standard error that is this part of sigma, or more, tells nothing."""
_APART = 0.02
"""Relative step for the curvature of the likelihood."""


@dataclass(frozen=True)
class IdleNoise:
    """Noise of a frame before rounding and clipping.

    Attributes:
        sigma_counts: the most likely one; NaN where idle frames say nothing.
        error_counts: its standard error.
    """

    sigma_counts: float = float("nan")
    error_counts: float = float("inf")

    @property
    def known(self) -> bool:
        """Whether the frames said anything worth knowing."""
        return bool(self.error_counts < _USELESS * self.sigma_counts)


def idle_noise(counts: FloatArray, readout: Readout) -> IdleNoise:
    """The noise that idle frames show.

    Args:
        counts: (M, J) frames without a press, in the order of time.
        readout: the converter; of counts that are not whole numbers nothing is said.
    """
    if not readout.integer or readout.rest_subtracted or len(counts) < _FEWEST:
        return IdleNoise()
    cells = _cells_of(counts, readout)
    if not len(cells):
        return IdleNoise()
    spans = np.fmax.reduce(cells, axis=1) - np.fmin.reduce(cells, axis=1)
    # The quieter half to begin with: a glitch or a jump is not in it unless there is one everywhere.
    kept: BoolArray = spans <= np.median(spans)
    near: BoolArray = spans <= _FAR * np.median(spans) + 1
    values, numbers = _histograms(cells[near])
    edges, kept = _edges(values, readout), kept[near]
    levels = (numbers * values).sum(axis=1) / numbers.sum(axis=1)
    found = IdleNoise()
    for _ in range(_ROUNDS):
        found = _most_likely(edges[kept], numbers[kept], levels[kept])
        if not found.known:
            break
        usual = _usual(float(np.log(found.sigma_counts)), edges, numbers, levels)
        if (usual == kept).all():
            break
        kept = usual
    return found


def _most_likely(edges: FloatArray, numbers: FloatArray, levels: FloatArray) -> IdleNoise:
    """The noise of some histograms (C, B), with levels (C,) to begin from."""
    if not len(levels):
        return IdleNoise()

    def surprise(log_sigma: float) -> float:
        return float(_surprise(log_sigma, edges, numbers, levels).sum())

    ends = float(np.log(_LEAST_SIGMA)), float(np.log(_MOST_SIGMA))
    best = float(minimize_scalar(surprise, bounds=ends, method="bounded", options={"xatol": 1e-4}).x)
    bend = (surprise(best + _APART) - 2 * surprise(best) + surprise(best - _APART)) / _APART**2
    if bend <= 0 or not ends[0] + 0.1 < best < ends[1] - 0.1:
        return IdleNoise()
    sigma = float(np.exp(best))
    return IdleNoise(sigma, sigma / float(np.sqrt(bend)))


def _usual(log_sigma: float, edges: FloatArray, numbers: FloatArray, levels: FloatArray) -> BoolArray:
    """(C,) which histograms pull at sigma no harder than chance lets them: no glitch, no jump, no taxel in motion."""
    low, at, high = (_surprise(log_sigma + step, edges, numbers, levels) for step in (-_APART, 0.0, _APART))
    pull, bend = (high - low) / (2 * _APART), (high - 2 * at + low) / _APART**2
    return np.abs(pull) <= _HARD * np.sqrt(np.maximum(bend, 1.0))


def _cells_of(counts: FloatArray, readout: Readout) -> FloatArray:
    """Whole counts (C, n) of each taxel in each stretch, NaN for none; those that say nothing are left out."""
    stretches: list[FloatArray] = np.array_split(counts, max(1, len(counts) // STRETCH))
    most = max(1, _ENOUGH // max(counts.shape[1], 1))
    if len(stretches) > most:
        stretches = [stretches[k] for k in np.linspace(0, len(stretches) - 1, most).astype(int).tolist()]
    cells = np.concatenate([_padded(part) for part in stretches])
    low, high = np.fmin.reduce(cells, axis=1), np.fmax.reduce(cells, axis=1)
    frames = np.isfinite(cells).sum(axis=1)
    top = np.inf if readout.value_max is None else readout.value_max
    use: BoolArray = (frames >= _FEWEST) & (high > low) & (high < top)
    if readout.value_min is None:
        # Where the converter clips is not known: a taxel that mostly reads its lowest count may be clipped there.
        at = [(cells == low[:, None] + k).sum(axis=1) for k in (0, 1)]
        use &= at[0] < at[1]
    return cells[use]


def _histograms(cells: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Counts (C, B) and how often each was read (C, B)."""
    low, high = np.fmin.reduce(cells, axis=1), np.fmax.reduce(cells, axis=1)
    bins = int((high - low).max()) + 1
    place = cells - low[:, None]
    numbers = np.stack([(place == k).sum(axis=1) for k in range(bins)], axis=1)
    return low[:, None] + np.arange(bins), numbers.astype(np.float64)


def _padded(part: FloatArray) -> FloatArray:
    """(J, n) whole counts of a stretch of frames; NaN fills what a shorter one lacks."""
    room = np.full((part.shape[1], 2 * STRETCH), np.nan)
    room[:, : len(part)] = np.rint(part.T)
    return room


def _edges(values: FloatArray, readout: Readout) -> FloatArray:
    """Borders (C, B + 1) between the counts: what lies below the converter's least count is read as that."""
    edges = np.concatenate([values - 0.5, values[:, -1:] + 0.5], axis=1)
    if readout.value_min is not None:
        edges[values[:, 0] <= readout.value_min, 0] = -np.inf
    return edges


def _surprise(log_sigma: float, edges: FloatArray, numbers: FloatArray, levels: FloatArray) -> FloatArray:
    """Least negative logarithms of the likelihood (C,) at a sigma, with every level at its best."""
    sigma = float(np.exp(log_sigma))
    low, high = levels - 6 * sigma - 1, levels + 2 * sigma + 1
    # The likelihood of Gaussian bins has one peak in the level: sections in the ratio of two thirds close in on it.
    for _ in range(_STEPS):
        third = (high - low) / 3
        left, right = low + third, high - third
        better = _cells(sigma, edges, numbers, left) < _cells(sigma, edges, numbers, right)
        low, high = np.where(better, low, left), np.where(better, right, high)
    return _cells(sigma, edges, numbers, (low + high) / 2)


def _cells(sigma: float, edges: FloatArray, numbers: FloatArray, levels: FloatArray) -> FloatArray:
    z = (edges - levels[:, None]) / sigma
    # From the tail that is nearer, so that far bins keep their digits.
    chance = np.where(z[:, :-1] > 0, ndtr(-z[:, :-1]) - ndtr(-z[:, 1:]), ndtr(z[:, 1:]) - ndtr(z[:, :-1]))
    return -(numbers * np.log(np.maximum(chance, 1e-300))).sum(axis=1)
