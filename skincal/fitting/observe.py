"""From counts to taxel loads: the level at rest, the converter's rounding and clipping, dead and saturated taxels.

A mean over frames of a clipped, rounded, noisy signal is not the clipped mean: a taxel at 0 counts with one count of
noise reads 0.4 on average. Its expectation is a smooth monotone function of the taxel's load, and is inverted here, so
that everything after works with unclipped values.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtr, ndtri

from skincal.fitting.types import Bools, Floats
from skincal.model.converter import Converter
from skincal.model.rest import RestLevels, levels_from_presses

_SPREAD = 8.0
"""Beyond so many sigmas from a bound of the converter, clipping does not matter."""

_KNOTS = 200
"""Knots of an interpolation for each sigma."""

_FINEST = 2e-4
"""Counts between two knots at least."""

_FEW = 64
"""So many values are worked out one by one: for fewer, a table is not worth its making."""

_FRAMES_OF_REST = 20.0
"""Frames at rest are so many at least."""

_MAX_CLIPPED_REST = 1.5
"""A level at rest up to so many counts above ``value_min`` is explained by clipped noise; a higher one is an offset."""


@dataclass(frozen=True)
class Readout:
    """The conversion of a value by the sensor before it is stored.

    Attributes:
        value_min: where the converter clips [counts]; None where not known.
        value_max: the same above.
        integer: whether counts are whole numbers.
        rest_subtracted: whether the level at rest has been taken off.
    """

    value_min: float | None
    value_max: float | None
    integer: bool
    rest_subtracted: bool = False

    @property
    def converter(self) -> Converter:
        """Converter of the model; none where rest has been taken off, as it then clips at an unknown level."""
        if self.rest_subtracted:
            return Converter.none()
        return Converter(self.value_min, self.value_max, self.integer)


@dataclass(frozen=True, eq=False)
class Observed:
    """Counts as unclipped values above the level at rest.

    Attributes:
        values: (K, J) values [counts]; NaN where a taxel was not read.
        slope: (K, J) how much of a change of the value the counts show, in (0, 1]; small near a bound.
        saturated: (K, J) at the upper bound: the value is at least this.
        rest_counts: (J,) level at rest that was taken off, beyond what clipped noise explains [counts].
        frame_sigma_counts: noise of one frame that the level at rest betrays [counts]; NaN where it does not.
        rest_sigma_counts: scatter of the hold means of untouched taxels [counts].
        level_sigma_counts: (J,) what is known of the level at rest before the fit, one sigma [counts].
        level_known: (J,) the taxel was seen at rest.
    """

    values: Floats
    slope: Floats
    saturated: Bools
    rest_counts: Floats
    frame_sigma_counts: float
    rest_sigma_counts: float
    level_sigma_counts: Floats
    level_known: Bools


def expected_counts(value: Floats, sigma: float, readout: Readout) -> Floats:
    """Mean count of a taxel at ``value`` with Gaussian noise ``sigma``, rounded and clipped.

    Args:
        value: any shape [counts].
        sigma: noise of one frame [counts].
        readout: bounds and rounding.
    """
    value = np.asarray(value, dtype=np.float64)
    if readout.rest_subtracted:
        # Bounds are those of the raw counts, and rest may be anywhere between them.
        return value.copy()
    low, high = readout.value_min, readout.value_max
    if sigma <= 0:
        return np.clip(value, low, high)
    out = value.copy()
    if low is not None:
        out = out + _lifted(value - low, sigma, readout.integer)
    if high is not None:
        out = out - _lifted(high - value, sigma, readout.integer)
    return out


def _lifted(above: Floats, sigma: float, integer: bool) -> Floats:
    """Return how much clipping at 0 lifts the mean of a value ``above`` it."""
    if not integer:
        z = above / sigma
        return sigma * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) - above * ndtr(-z)
    steps = _steps(sigma)
    # More are those of a session or of presses followed by themselves: a value reads the same in both.
    lifted = _rounded(above, sigma, steps) if above.size <= _FEW else np.interp(above, *_table(sigma))
    return np.where(above < -steps[-1], -above, lifted)


def _steps(sigma: float) -> Floats:
    """Halves of counts below zero that noise may reach."""
    return np.arange(1, int(np.ceil(_SPREAD * sigma)) + 2) - 0.5


def _rounded(above: Floats, sigma: float, steps: Floats) -> Floats:
    """The sum over the counts below zero of their distance times their probability, P(round(x) <= -k), k >= 1."""
    return ndtr((-steps - above[..., None]) / sigma).sum(axis=-1)


@lru_cache(maxsize=256)
def _table(sigma: float) -> tuple[Floats, Floats]:
    """Knots (K,), and how much values there are lifted: lines between them are right to 5e-6 (sigma + 1 count)."""
    steps = _steps(sigma)
    knots = np.arange(-steps[-1], _SPREAD * sigma, max(sigma / _KNOTS, _FINEST))
    return knots, _rounded(knots, sigma, steps)


def clipped_share(value: float, sigma: float, readout: Readout) -> float:
    """Return how much of the scatter of a frame is left at ``value`` by rounding and clipping, in (0, 1].

    Args:
        value: of the taxel [counts].
        sigma: noise of one frame [counts].
        readout: bounds and rounding.
    """
    step = 1.0 if readout.integer else sigma / 20
    edge = int(np.ceil(_SPREAD * sigma / step + 1))
    centre = float(np.rint(value)) if readout.integer else value
    steps: Floats = centre + step * np.arange(-edge, edge + 1, dtype=np.float64)
    borders: Floats = np.append(steps - step / 2, steps[-1] + step / 2)
    chance: Floats = np.diff(ndtr((borders - value) / sigma))
    clipped = _scatter(np.clip(steps, readout.value_min, readout.value_max), chance)
    return clipped / _scatter(steps, chance)


def _scatter(values: Floats, chance: Floats) -> float:
    return float(np.sqrt(max(chance @ values**2 - (chance @ values) ** 2, 1e-12)))


def noise_from_rest(rest_mean: float, readout: Readout) -> float:
    """Noise of one frame [counts] that lifts an untouched taxel to ``rest_mean`` above the lower bound."""
    if readout.value_min is None or not 0.0 < rest_mean - readout.value_min <= _MAX_CLIPPED_REST:
        return float("nan")
    if not readout.integer:  # half of a normal distribution
        return float(np.sqrt(2 * np.pi) * (rest_mean - readout.value_min))
    sigmas = np.linspace(0.05, 4.5, 446)
    means = [
        float(expected_counts(np.array(readout.value_min), s, readout)) - readout.value_min for s in sigmas
    ]
    return float(np.interp(rest_mean - readout.value_min, means, sigmas))


def observe(counts: Floats, readout: Readout, rest_mean: Floats | None = None) -> Observed:
    """Turn hold means into unclipped values above the level at rest.

    Args:
        counts: (K, J) mean counts of the presses; NaN where not read.
        readout: what is known of the converter.
        rest_mean: (J,) mean counts of untouched taxels, from idle frames; None to take it from the presses
            that leave a taxel dark (the lower third of its readings).

    Returns:
        Values, with what is known of their noise.
    """
    counts = np.asarray(counts, dtype=np.float64)
    found = levels_from_presses(counts)
    level, scatter, known = found.level.copy(), found.scatter, found.known.copy()
    measured = np.zeros(len(level), dtype=bool) if rest_mean is None else np.isfinite(rest_mean)
    if rest_mean is not None:
        level[measured] = rest_mean[measured]
    known |= measured
    sigma = float("nan")
    if not readout.rest_subtracted:
        sigma = _noise_on_bound(counts, replace(found, level=level), readout)
    if np.isfinite(sigma):
        values, slope, saturated, rest, own = _unclipped(counts, readout, level, sigma, scatter, known)
        apart = own[known]
    else:
        high = np.inf if readout.value_max is None else readout.value_max
        saturated = np.nan_to_num(counts, nan=-np.inf) >= high - (0.5 if readout.integer else 0.0)
        rest = np.zeros_like(level) if readout.rest_subtracted else np.nan_to_num(level)
        values, slope = counts - rest, np.ones_like(counts)
        apart = level[known]
        if not readout.rest_subtracted and known.any():
            apart = apart - float(np.median(apart))
    spread = np.where(
        measured, np.nan_to_num(scatter) / np.sqrt(_FRAMES_OF_REST), _spread(apart, scatter, len(counts))
    )
    return Observed(values, slope, saturated, rest, sigma, scatter, spread, known)


def _spread(apart: Floats, scatter: float, rows: int) -> float:
    """Return what is known of a level before the fit [counts], from how far levels (n,) lie apart.

    The presses that leave a taxel alone tell its level, and they are in the likelihood: beforehand there is no more
    than how far the levels of taxels lie apart. A level from frames at rest is a measurement of its own.
    """
    # Of n levels the spread is known to 1 / sqrt(2 n); twice of it covers that of few.
    spread = 2.0 * float(np.sqrt(np.mean(apart**2))) if len(apart) > 1 else 0.0
    return max(spread, float(np.nan_to_num(scatter)) / np.sqrt(max(rows, 1)))


_ON_BOUND = 0.1
"""Where this part of the readings at rest lies on the bound itself, presses are single frames, or means of few."""

_APART = 4.0
"""Levels that lie apart by so many standard errors are levels, and no noise on the bound."""


def _noise_on_bound(counts: Floats, found: RestLevels, readout: Readout) -> float:
    """Noise of one frame [counts] where taxels rest on the lower bound of the converter, NaN where they do not.

    Readings on the bound itself tell it with the mean above it. Of means of many frames none lies there, and rounded
    readings lie there by rounding: then the level at rest is taken for the bound, and its lift tells the noise. Such a
    lift is no more than a small part of the range, and has a scatter: that of a mean of some hundreds of frames is a
    twentieth of it. Where levels lie apart, how their scatters differ tells which part of the noise the bound leaves
    each.
    """
    low, known = readout.value_min, found.known & np.isfinite(found.level)
    if low is None or not known.any() or not np.isfinite(found.scatter):
        return float("nan")
    lift, dark, scatter = found.level[known] - low, np.maximum(found.dark[known], 1), found.scatters[known]
    on_bound = (counts[:, known] <= low).sum(axis=0)
    if on_bound.sum() >= _ON_BOUND * dark.sum() and not readout.integer:
        return _noise_of_frames(lift, on_bound / dark)
    middle = float(np.median(lift))
    if not 0.0 < middle < 20.0 * found.scatter:
        return float("nan")
    apart = TO_SIGMA * float(np.median(np.abs(lift - middle)))
    if apart > _APART * found.scatter / np.sqrt(float(np.median(dark))):
        return _noise_of_levels(lift, scatter, dark)
    most = _MAX_CLIPPED_REST / 255.0 * float(np.nanmax(counts) - low)
    return float("nan") if middle > most and not readout.integer else noise_from_rest(middle + low, readout)


TO_SIGMA = 1.4826
"""Standard deviation over the median absolute deviation of normal noise."""
_SEEN = 9.0
"""Clipping is seen in the scatters of levels where it explains them by so much better, in chi squared (3 sigmas)."""


def _noise_of_frames(lift: Floats, on_bound: Floats) -> float:
    """Noise of frames, from the mean lift of each taxel (J,) and the part of its readings on the bound (J,)."""
    use = (on_bound > 0.05) & (on_bound < 0.95)
    if not use.any():
        return float("nan")
    # x > 0 with the chance above; the mean of what is above is sigma (t above + density).
    t = -ndtri(on_bound[use])
    above, density = ndtr(t), np.exp(-0.5 * t * t) / np.sqrt(2 * np.pi)
    sigma = float(np.median(lift[use] / (t * above + density)))
    return sigma if sigma > 0 else float("nan")


def _noise_of_levels(lift: Floats, scatter: Floats, dark: Floats) -> float:
    """Noise of which a bound leaves each level its part: the one that explains how scatters (J,) differ."""
    t: Floats = np.linspace(-4.0, 8.0, 600)
    above: Floats = np.asarray(ndtr(t), dtype=np.float64)
    density: Floats = np.exp(-0.5 * t * t) / np.sqrt(2 * np.pi)
    mean: Floats = density + t * above
    share: Floats = np.sqrt(np.maximum((1 + t * t) * above + t * density - mean**2, 1e-12))
    use = (scatter > 0) & (lift > 0)
    if use.sum() < 3:
        return float("nan")
    sigmas: Floats = np.sqrt(2 * np.pi) * float(np.median(lift)) * np.geomspace(0.1, 3.0, 60)
    shares: Floats = np.interp(lift[use] / sigmas[:, None], mean, share)
    off = np.log(scatter[use]) - np.log(shares)
    weight = dark[use] / dark[use].sum()
    # The logarithm of a scatter of n readings is known to 1 / sqrt(2 n). With the least noise nothing is clipped.
    squares = 2 * dark[use].sum() * (((off - (off @ weight)[:, None]) ** 2) @ weight)
    best = int(np.argmin(squares))
    return float(sigmas[best]) if squares[best] < squares[0] - _SEEN else float("nan")


_LEAST = 0.02
"""A level at rest is not better known than this part of the noise of a frame."""


def _unclipped(
    counts: Floats, readout: Readout, rest: Floats, sigma: float, scatter: float, known: Bools
) -> tuple[Floats, Floats, Bools, Floats, Floats]:
    """Undo the clipping of noise on the lower bound.

    Args:
        counts: (K, J) mean counts.
        readout: bounds and rounding.
        rest: (J,) mean counts at rest.
        sigma: noise of one frame [counts].
        scatter: of the hold means of untouched taxels [counts].
        known: (J,) taxels that were seen at rest.

    Returns:
        Values above rest, the part of their change that counts show, and which are saturated, each (K, J); levels at
        rest that were taken off, and those that counts at rest stand for, each (J,).
    """
    low = readout.value_min if readout.value_min is not None else 0.0
    high = readout.value_max if readout.value_max is not None else max(float(np.nanmax(counts)), low) + 50.0
    # Values between which clipping is undone: close where it bends, far apart where it does nothing.
    near = sigma * np.arange(-2.5, _SPREAD, 0.02)
    knots = np.concatenate([low + near, high - near])
    knots = np.unique(knots[(knots >= low + near[0]) & (knots <= high - near[0])])
    means = expected_counts(knots, sigma, readout)
    values = np.interp(counts, means, knots)
    values[np.isnan(counts)] = np.nan
    own = np.nan_to_num(np.interp(rest, means, knots) - low)
    # A level that differs from the bound by less than its own scatter is no offset, unless levels do so all together.
    doubt = _APART * max(scatter, _LEAST * sigma) / np.sqrt(max(1.0, len(counts) / 3))
    lift = np.nan_to_num(rest, nan=low) - low - (float(expected_counts(np.array(low), sigma, readout)) - low)
    together = float(np.sqrt(np.mean(lift[known] ** 2))) if known.any() else 0.0
    offset = np.where((np.abs(lift) > doubt) | (together > 0.5 * doubt), own, 0.0)
    saturated = np.nan_to_num(counts, nan=-np.inf) >= high - max(0.5 if readout.integer else 0.0, sigma)
    slope = np.maximum(np.interp(counts, means, np.gradient(means, knots)), 0.05)
    return values - low - offset, slope, saturated, offset, own
