"""From counts to taxel loads: rest level, rounding and clipping of the converter, saturated taxels.

The mean over frames of a clipped, rounded, noisy signal is not the clipped mean: a taxel at 0 counts with one
count of noise reads 0.4 on average. Its expectation is a smooth monotone function of the taxel's load. It is
inverted here, so that all later steps work with unclipped values.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtr, ndtri

from skincal.fitting.types import Bools, Floats
from skincal.model.rest import RestLevels, levels_from_presses
from skincal.statistics import robust_sigma

_CLIP_SIGMAS = 8.0
"""Distance from a bound of the converter, in sigmas, beyond which clipping has no effect: a numerical tolerance."""

_KNOTS_PER_SIGMA = 200
"""Interpolation knots per sigma."""

_MIN_KNOT_STEP = 2e-4
"""Smallest distance of two knots [counts]."""

_MOST_EXACT = 64
"""Up to this many values are computed one by one, as a table would cost more."""

_MIN_REST_FRAMES = 20.0
"""Least number of frames that a mean at rest is taken over."""

_MAX_CLIPPED_REST = 1.5
"""Highest rest level above ``value_min`` that clipped noise explains [counts]; a higher one is an offset."""


@dataclass(frozen=True)
class Readout:
    """The conversion of a value by the sensor before it is stored.

    Attributes:
        value_min: lower clipping bound of the converter [counts]; None if unknown.
        value_max: upper clipping bound [counts]; None if unknown.
        integer: whether counts are whole numbers.
        rest_subtracted: whether the rest level has already been subtracted.
    """

    value_min: float | None
    value_max: float | None
    integer: bool
    rest_subtracted: bool = False


@dataclass(frozen=True, eq=False)
class ImagesAboveRest:
    """Counts as unclipped values above the rest level.

    Attributes:
        values: (K, J) values [counts]; NaN where a taxel was not read.
        slope: (K, J) derivative of the counts by the value, in (0, 1]; small near a bound.
        saturated: (K, J) at the upper bound: the value is at least this.
        rest_counts: (J,) rest level that was subtracted, beyond what clipped noise explains [counts].
        frame_sigma_counts: noise of one frame, inferred from the clipped rest level [counts]; NaN if it
            cannot be inferred.
        rest_sigma_counts: scatter of the hold means of untouched taxels [counts].
        level_sigma_counts: (J,) prior standard deviation of the rest level [counts].
        level_known: (J,) whether the taxel was seen at rest.
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
    """Return the mean count of a taxel at values (…) with Gaussian noise ``sigma`` of a frame, rounded and clipped."""
    value = np.asarray(value, dtype=np.float64)
    if readout.rest_subtracted:
        # The bounds belong to the raw counts, and rest may lie anywhere between them.
        return value.copy()
    low, high = readout.value_min, readout.value_max
    if sigma <= 0:
        return np.clip(value, low, high)
    out = value.copy()
    if low is not None:
        out = out + _clipping_lift(value - low, sigma, readout.integer)
    if high is not None:
        out = out - _clipping_lift(high - value, sigma, readout.integer)
    return out


def _clipping_lift(above: Floats, sigma: float, integer: bool) -> Floats:
    """Return by how much clipping at 0 raises the mean of a value that lies ``above`` the bound."""
    if not integer:
        z = above / sigma
        return sigma * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) - above * ndtr(-z)
    steps = _half_counts(sigma)
    # Larger arrays are whole sessions, or presses repeated. All of them use the table, so a value reads
    # the same in each.
    lifted = (
        _rounding_lift(above, sigma, steps)
        if above.size <= _MOST_EXACT
        else np.interp(above, *_tabulate_lift(sigma))
    )
    return np.where(above < -steps[-1], -above, lifted)


def _half_counts(sigma: float) -> Floats:
    """Return the rounding borders below zero that noise may reach, as positive numbers."""
    return np.arange(1, int(np.ceil(_CLIP_SIGMAS * sigma)) + 2) - 0.5


def _rounding_lift(above: Floats, sigma: float, steps: Floats) -> Floats:
    """Return the sum over k >= 1 of P(round(x) <= -k): the mean that clipping cuts off below zero."""
    return ndtr((-steps - above[..., None]) / sigma).sum(axis=-1)


@lru_cache(maxsize=256)
def _tabulate_lift(sigma: float) -> tuple[Floats, Floats]:
    """Return knots (K,) and the lift there; linear interpolation is accurate to 5e-6 (sigma + 1 count)."""
    steps = _half_counts(sigma)
    knots = np.arange(-steps[-1], _CLIP_SIGMAS * sigma, max(sigma / _KNOTS_PER_SIGMA, _MIN_KNOT_STEP))
    return knots, _rounding_lift(knots, sigma, steps)


def clipped_share(value: float, sigma: float, readout: Readout) -> float:
    """Return the fraction of a frame's standard deviation ``sigma`` that rounding and clipping leave, in (0, 1]."""
    step = 1.0 if readout.integer else sigma / 20
    edge = int(np.ceil(_CLIP_SIGMAS * sigma / step + 1))
    centre = float(np.rint(value)) if readout.integer else value
    steps: Floats = centre + step * np.arange(-edge, edge + 1, dtype=np.float64)
    borders: Floats = np.append(steps - step / 2, steps[-1] + step / 2)
    chance: Floats = np.diff(ndtr((borders - value) / sigma))
    clipped = _standard_deviation(np.clip(steps, readout.value_min, readout.value_max), chance)
    return clipped / _standard_deviation(steps, chance)


def _standard_deviation(values: Floats, chance: Floats) -> float:
    """Return the standard deviation of a discrete distribution: values (N,) with probabilities (N,)."""
    return float(np.sqrt(max(chance @ values**2 - (chance @ values) ** 2, 1e-12)))


def noise_from_rest(rest_mean: float, readout: Readout) -> float:
    """Return the noise of one frame [counts] that lifts the mean at rest to ``rest_mean``; NaN if none does."""
    if readout.value_min is None or not 0.0 < rest_mean - readout.value_min <= _MAX_CLIPPED_REST:
        return float("nan")
    if not readout.integer:  # mean of a rectified normal distribution
        return float(np.sqrt(2 * np.pi) * (rest_mean - readout.value_min))
    sigmas = np.linspace(0.05, 4.5, 446)
    means = [
        float(expected_counts(np.array(readout.value_min), s, readout)) - readout.value_min for s in sigmas
    ]
    return float(np.interp(rest_mean - readout.value_min, means, sigmas))


def observe(counts: Floats, readout: Readout, rest_mean: Floats | None = None) -> ImagesAboveRest:
    """Turn hold means into unclipped values above the rest level.

    Args:
        counts: (K, J) mean counts of the presses; NaN where not read.
        readout: what is known of the converter.
        rest_mean: (J,) mean counts of untouched taxels, from idle frames. None to estimate it from the
            presses that leave a taxel dark (the lower third of its readings).
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
        sigma = _noise_at_bound(counts, replace(found, level=level), readout)
    if np.isfinite(sigma):
        values, slope, saturated, rest, own = _undo_clipping(counts, readout, level, sigma, scatter, known)
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
        measured,
        np.nan_to_num(scatter) / np.sqrt(_MIN_REST_FRAMES),
        _level_sigma(apart, scatter, len(counts)),
    )
    return ImagesAboveRest(values, slope, saturated, rest, sigma, scatter, spread, known)


def _level_sigma(apart: Floats, scatter: float, rows: int) -> float:
    """Return the prior standard deviation of a rest level [counts] from the deviations (n,) of the levels.

    The presses that leave a taxel untouched measure its level, and they are part of the likelihood. The prior
    must not use them again, so it only holds the scatter of the levels between taxels. A level from idle
    frames is a measurement of its own, and has its own standard deviation.
    """
    # The spread of n levels has a relative error of 1 / sqrt(2 n); a factor of two covers small n.
    spread = 2.0 * float(np.sqrt(np.mean(apart**2))) if len(apart) > 1 else 0.0
    return max(spread, float(np.nan_to_num(scatter)) / np.sqrt(max(rows, 1)))


_BOUND_FRACTION = 0.1
"""If at least this fraction of the readings at rest lies on the bound itself, presses are single frames or means
of few."""

_LEVEL_SIGMAS = 4.0
"""Rest levels that differ by this many standard errors are real levels, not noise clipped at the bound."""


def _noise_at_bound(counts: Floats, found: RestLevels, readout: Readout) -> float:
    """Return the noise of one frame [counts] if taxels rest on the lower bound of the converter, else NaN.

    If readings lie on the bound itself, their fraction and the mean above the bound determine the noise.
    Means of many frames never lie on it, and rounded readings lie there by rounding. In those cases the rest
    level is taken to be the bound, and the lift of the mean determines the noise. Such a lift must be a small
    part of the range and must have a scatter: the scatter of a mean of some hundred frames is a twentieth of
    the lift. If the levels of the taxels differ, their different scatters show what fraction of the noise the
    bound leaves each of them.
    """
    low, known = readout.value_min, found.known & np.isfinite(found.level)
    if low is None or not known.any() or not np.isfinite(found.scatter):
        return float("nan")
    lift, dark, scatter = found.level[known] - low, np.maximum(found.dark[known], 1), found.scatters[known]
    on_bound = (counts[:, known] <= low).sum(axis=0)
    if on_bound.sum() >= _BOUND_FRACTION * dark.sum() and not readout.integer:
        return _noise_from_bound_fraction(lift, on_bound / dark)
    middle = float(np.median(lift))
    if not 0.0 < middle < 20.0 * found.scatter:
        return float("nan")
    apart = robust_sigma(lift)
    if apart > _LEVEL_SIGMAS * found.scatter / np.sqrt(float(np.median(dark))):
        return _noise_from_level_scatter(lift, scatter, dark)
    most = _MAX_CLIPPED_REST / 255.0 * float(np.nanmax(counts) - low)
    return float("nan") if middle > most and not readout.integer else noise_from_rest(middle + low, readout)


_CHI2_GAIN = 9.0
"""Least reduction of chi squared (3 sigmas) by which clipping must explain the scatters of the levels."""


def _noise_from_bound_fraction(lift: Floats, on_bound: Floats) -> float:
    """Return the noise of one frame [counts] from the mean lift (J,) and the fraction of readings on the bound (J,)."""
    use = (on_bound > 0.05) & (on_bound < 0.95)
    if not use.any():
        return float("nan")
    # Of x = sigma (t + noise), the part above 0 has the probability ``above``; the mean of max(x, 0) is
    # sigma (t above + density).
    t = -ndtri(on_bound[use])
    above, density = ndtr(t), np.exp(-0.5 * t * t) / np.sqrt(2 * np.pi)
    sigma = float(np.median(lift[use] / (t * above + density)))
    return sigma if sigma > 0 else float("nan")


def _noise_from_level_scatter(lift: Floats, scatter: Floats, dark: Floats) -> float:
    """Return the noise of one frame [counts] that best explains how the scatters (J,) differ between clipped levels."""
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
    # The log of a standard deviation of n readings has a standard error of 1 / sqrt(2 n). With the
    # smallest trial noise nothing is clipped.
    squares = 2 * dark[use].sum() * (((off - (off @ weight)[:, None]) ** 2) @ weight)
    best = int(np.argmin(squares))
    return float(sigmas[best]) if squares[best] < squares[0] - _CHI2_GAIN else float("nan")


_LEVEL_PART = 0.02
"""Lower bound of the uncertainty of a rest level, as a fraction of the noise of a frame."""


def _undo_clipping(
    counts: Floats, readout: Readout, rest: Floats, sigma: float, scatter: float, known: Bools
) -> tuple[Floats, Floats, Bools, Floats, Floats]:
    """Undo the clipping of noise at the bounds, in mean counts (K, J) and in those at rest (J,).

    Returns:
        Values above rest, derivative of the counts by the value, and saturation, each (K, J); subtracted rest
        levels, and unclipped values of the mean counts at rest, each (J,).
    """
    low = readout.value_min if readout.value_min is not None else 0.0
    high = readout.value_max if readout.value_max is not None else max(float(np.nanmax(counts)), low) + 50.0
    # Knots of the inversion: close together where the curve bends, far apart where it is straight.
    near = sigma * np.arange(-2.5, _CLIP_SIGMAS, 0.02)
    knots = np.concatenate([low + near, high - near])
    knots = np.unique(knots[(knots >= low + near[0]) & (knots <= high - near[0])])
    means = expected_counts(knots, sigma, readout)
    values = np.interp(counts, means, knots)
    values[np.isnan(counts)] = np.nan
    own = np.nan_to_num(np.interp(rest, means, knots) - low)
    # A level that differs from the bound by less than its standard error is no offset, unless the levels
    # differ jointly.
    tolerance = _LEVEL_SIGMAS * max(scatter, _LEVEL_PART * sigma) / np.sqrt(max(1.0, len(counts) / 3))
    lift = np.nan_to_num(rest, nan=low) - low - (float(expected_counts(np.array(low), sigma, readout)) - low)
    joint = float(np.sqrt(np.mean(lift[known] ** 2))) if known.any() else 0.0
    offset = np.where((np.abs(lift) > tolerance) | (joint > 0.5 * tolerance), own, 0.0)
    saturated = np.nan_to_num(counts, nan=-np.inf) >= high - max(0.5 if readout.integer else 0.0, sigma)
    slope = np.maximum(np.interp(counts, means, np.gradient(means, knots)), 0.05)
    return values - low - offset, slope, saturated, offset, own
