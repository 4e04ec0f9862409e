"""Noise of a session, and mean, slope and variance of what the converter makes of a level.

A frame is ``round(level + noise)`` in steps of the converter, clipped. Mean and variance as functions of the level are
tabulated once. Where the noise is small against a step they are a staircase. The level at rest stands at one place of
it. The level of a pressed taxel is known only within the spread of the press's nuisance parameters; the expected value
is then the mean over that spread, and all frames of the level share a variance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from skincal.fitting.lookup import allocating
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.rounded_frames import noise_of_rounded
from skincal.model.arrays import BoolArray, FloatArray, IntArray
from skincal.statistics import robust_sigma

_NEAR, _FINE, _KNOTS = 8.0, 8.0, 4000
_FEW_AT_REST = 100
"""Least number of frames at rest that is used beside holds."""
_SHARED = 1.94
"""Variance inflation of estimates by second differences, which overlap: 1 + 2 (16 + 1) / 36."""
_AWAY = 4
"""Rounds in which the noise and the distance from the bounds at which it is estimated are alternated."""
_NODES = np.linspace(-3.0, 3.0, 13)
_WEIGHTS = np.exp(-0.5 * _NODES**2) / np.exp(-0.5 * _NODES**2).sum()
_NODES /= np.sqrt(_WEIGHTS @ _NODES**2)


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of a frame, and the converter.

    Attributes:
        sigma: (J,) standard deviation before rounding, at rest [counts].
        grows: part of the level above rest that is added to it, in quadrature.
        step: of the converter [counts]; 0 for values that are not rounded.
        low: lower bound of the converter [counts]; -inf if there is none, or it is not known.
        high: upper bound.
        force_n: noise of the measured force of a frame [N].
        rest: level at rest that all taxels share [counts].
        origin: a value on the grid of steps [counts].
        within: relative standard error of ``sigma``.
        stairs: staircase of which this noise is the linear approximation, with its rounding as scatter; None: exact.
    """

    sigma: FloatArray
    grows: float
    step: float
    low: float
    high: float
    force_n: float = 0.0
    rest: float = 0.0
    origin: float = 0.0
    within: float = 0.0
    stairs: Noise | None = None

    @cached_property
    def frame(self) -> float:
        """Standard deviation of the median taxel [counts]."""
        return max(float(np.median(self.sigma)), 1e-9)

    @property
    def coarse(self) -> bool:
        """True if rounding leaves a staircase."""
        return self.frame < C.smooth * self.step

    def _sd(self, level: FloatArray) -> FloatArray:
        return np.hypot(self.frame, self.grows * np.maximum(level - self.rest, 0.0))

    @cached_property
    def _as_line(self) -> Noise:
        """The same noise without rounding, with the variance of rounding added."""
        return replace(self, sigma=np.hypot(self.sigma, self.step / np.sqrt(12)), step=0.0, stairs=None)

    @cached_property
    def _table(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Levels near the bounds, or all of a staircase, with mean, slope and variance of a frame there."""
        x = np.zeros(0)
        if self.coarse:
            around = _NEAR * self.step
            # At higher levels the image error alone smooths the staircase.
            last = min(self.rest + C.smooth * self.step / C.image, self.high)
            x = np.arange(max(self.low, self.rest) - around, last + around, self.frame / _FINE)
        else:
            for end in (e for e in (self.low, self.high) if np.isfinite(e)):
                around = _NEAR * float(np.hypot(self._sd(np.array(end)), self.step))
                x = np.append(x, np.linspace(end - around, end + around, _KNOTS))
            x = np.unique(x)
        mean, variance = np.zeros_like(x), np.zeros_like(x)
        for rows in np.array_split(np.arange(len(x)), len(x) // 500 + 1):
            if len(rows):
                mean[rows], variance[rows] = self._rounded(x[rows])
        return x, mean, np.gradient(mean, x) if len(x) else x, variance

    def _rounded(self, level: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and variance of a frame, for levels (n,) near each other."""
        sd = self._sd(level)
        wide = _NEAR * float(sd.max())
        # A step far finer than the noise is replaced by a coarser one.
        step = self.step if self.step > wide / 200 else wide / 200
        begin = np.floor((level.min() - wide - self.origin) / step)
        end = np.ceil((level.max() + wide - self.origin) / step)
        k = self.origin + step * np.arange(begin, end + 1)
        below = ndtr((k[None, :-1] + step / 2 - level[:, None]) / sd[:, None])
        share = np.diff(below, axis=1, prepend=0.0, append=1.0)
        written = np.clip(k, self.low, self.high)
        mean = share @ written
        # About the mean, against cancellation of large numbers.
        off = written[None] - mean[:, None]
        return mean, (share * off**2).sum(axis=1)

    def moments(self, level: FloatArray, spread: FloatArray | None = None) -> tuple[FloatArray, ...]:
        """Return mean, slope and variance of a reading, and the variance that the frames of a level share.

        Args:
            level: of any shape [counts].
            spread: prior standard deviation of each level; None: the image error. Only a staircase uses it.
        """
        kept = shared_rounding(self.frame, self.step) if self.coarse else 0.0
        if self.stairs:
            _, slope, each, shared = self._as_line.moments(level)
            each = np.maximum(each - kept, C.least_variance * each)
            return self.stairs.moments(level, spread)[0], slope, each, shared + kept
        rounding = self.step**2 / 12 - kept
        flat = np.ascontiguousarray(level, dtype=np.float64).reshape(-1)
        bounds = np.array([[e, self._reach(e)] for e in (self.low, self.high)])
        mean, slope, each, least = _moments_between_bounds(
            self._table, flat, bounds, (self.frame, self.grows, self.rest, rounding)
        )
        shared = np.full_like(flat, kept)
        if self.coarse:
            x = self._table[0]
            spread = (C.image * np.abs(level - self.rest) if spread is None else spread).reshape(-1)
            near = (flat > x[0]) & (flat < x[-1]) & (np.hypot(self.frame, spread) < C.smooth * self.step)
            wide = np.where(spread > self.frame / _FINE, spread, 0.0)[near]
            mean[near], slope[near], each[near], shared[near] = _moments_on_stairs(
                *self._table, flat[near], wide
            )
        each = np.maximum(each, C.least_variance * least)
        return tuple(v.reshape(level.shape) for v in (mean, np.maximum(slope, C.least_slope), each, shared))

    def _reach(self, end: float) -> float:
        """Return the distance from a bound within which readings are clipped [counts]; 0 where the staircase holds."""
        far = self.coarse or not np.isfinite(end)
        return 0.0 if far else _NEAR * float(np.hypot(self._sd(np.array(end)), self.step))

    def rounded(self, value: FloatArray) -> FloatArray:
        """Round and clip values of any shape as the converter does [counts]."""
        return np.clip(
            self.origin + self.step * np.rint((value - self.origin) / self.step), self.low, self.high
        )

    def written(self, level: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the mean of a reading, and its slope, for levels of any shape [counts]."""
        return self.moments(level)[:2]  # type: ignore[return-value]

    def variance(self, level: FloatArray, frames: FloatArray) -> FloatArray:
        """Return the variance (N, J) of means over frames (N,) at levels (N, J) [counts²]."""
        _, _, each, shared = self.moments(level)
        return (each + (self.sigma**2 - self.frame**2)) / frames[:, None] + shared

    def level_of(self, mean: float, frames: float) -> tuple[float, float]:
        """Estimate the level whose frames have a mean, with its standard deviation [counts]."""
        x, m, _, v = self._table
        if not len(x) or not x[0] <= mean <= x[-1]:
            return mean, 0.0
        off = (m - mean) ** 2 / np.maximum(v / frames, (self.frame / _FINE) ** 2)
        w = np.exp(-0.5 * (off - off.min())) * np.gradient(x)
        w /= w.sum()
        middle = float(w @ x)
        return middle, float(np.sqrt(w @ (x - middle) ** 2))


@allocating
def _moments_on_stairs(x, mean, slope, variance, level, spread):
    """Average mean, slope and variance of a reading over the spread (m,) of each level (m,), by tables over uniform x.

    Returns:
        (4, m) mean, slope, variance of a frame, and the variance that all frames share. The part of the latter that is
        linear in the level belongs to the nuisance parameters that spread it.
    """
    out, last = np.zeros((4, len(level))), len(x) - 1.001
    for i in range(len(level)):
        square, known = 0.0, spread[i] == 0.0
        for n in range(1 if known else len(_NODES)):
            weight = 1.0 if known else _WEIGHTS[n]
            place = min(max((level[i] + _NODES[n] * spread[i] - x[0]) / (x[1] - x[0]), 0.0), last)
            k = int(place)
            t = place - k
            one = mean[k] + t * (mean[k + 1] - mean[k])
            out[0, i] += weight * one
            out[1, i] += weight * (slope[k] + t * (slope[k + 1] - slope[k]))
            out[2, i] += weight * (variance[k] + t * (variance[k + 1] - variance[k]))
            square += weight * (one - level[i]) ** 2
        out[3, i] = max(square - (out[0, i] - level[i]) ** 2 - (out[1, i] * spread[i]) ** 2, 0.0)
    return out


@allocating
def _moments_between_bounds(table, level, bounds, noise):
    """Compute mean, slope and variance of a frame at levels (m,), and the variance without bounds: (4, m).

    Args:
        table: ascending levels near the bounds, with mean, slope and variance of a frame there.
        level: (m,).
        bounds: (2, 2) lower and upper bound, and the distance from each within which the table holds.
        noise: noise at rest, its growth, the level at rest, and the variance of rounding.
    """
    (x, mean, slope, variance), (frame, grows, rest, rounding) = table, noise
    out = np.empty((4, len(level)))
    for i in range(len(level)):
        more = grows * max(level[i] - rest, 0.0)
        out[0, i] = min(max(level[i], bounds[0, 0]), bounds[1, 0])
        out[1, i] = 1.0 if out[0, i] == level[i] else 0.0
        out[2, i] = out[3, i] = frame * frame + more * more + rounding
        if not (abs(level[i] - bounds[0, 0]) < bounds[0, 1] or abs(level[i] - bounds[1, 0]) < bounds[1, 1]):
            continue
        k, end = 0, len(x) - 1
        while end - k > 1:
            middle = (k + end) // 2
            if x[middle] <= level[i]:
                k = middle
            else:
                end = middle
        t = min(max((level[i] - x[k]) / (x[k + 1] - x[k]), 0.0), 1.0)
        out[0, i] = mean[k] + t * (mean[k + 1] - mean[k])
        out[1, i] = slope[k] + t * (slope[k + 1] - slope[k])
        out[2, i] = variance[k] + t * (variance[k + 1] - variance[k])
    return out


def shared_rounding(sigma: float, step: float) -> float:
    """Return the variance of the mean of a rounded, noisy level over its place within a step [counts²].

    The Fourier series of the rounding error, each wave damped by the noise.
    """
    if not step:
        return 0.0
    k = np.arange(1, 7)
    waves = step / (np.pi * k) * np.exp(-2 * (np.pi * k * sigma / step) ** 2)
    return float((waves**2).sum() / 2)


def sigma_before_rounding(variance: float, step: float) -> float:
    """Return the noise whose rounded frames have a variance about their mean, for levels anywhere within a step."""
    low, high = 0.0, float(np.sqrt(max(variance, 0.0))) + step
    for _ in range(50):
        middle = (low + high) / 2
        seen = middle**2 + step**2 / 12 - shared_rounding(middle, step)
        low, high = (middle, high) if seen < variance else (low, middle)
    return (low + high) / 2


def step_of(counts: FloatArray) -> float:
    """Return the step in which values come; 0 if they are no multiples of one."""
    some = np.unique(counts[np.isfinite(counts)].ravel()[:200_000])
    if len(some) < 3 or len(some) > 20_000:
        return 0.0
    apart = np.diff(some)
    step = float(apart.min())
    whole = apart / step
    return (
        step
        if step > 1e-9 * np.abs(some).max(initial=1.0) and np.abs(whole - np.rint(whole)).max() < 1e-6
        else 0.0
    )


def noise_of(
    counts: FloatArray,
    hold: IntArray,
    rest: IntArray,
    force_n: FloatArray,
    low: float,
    high: float,
    *,
    integer: bool,
) -> Noise:
    """Estimate the noise from consecutive frames.

    Args:
        counts: (M, J) frames.
        hold: (M,) hold of each, -1 for none.
        rest: (M,) stretch of rest of each, -1 for none.
        force_n: (M,) measured force.
        low: lower bound of the converter; -inf if there is none.
        high: upper bound.
        integer: True if values are whole numbers.
    """
    # A bound need not lie on the grid of steps.
    between = counts[(counts > low) & (counts < high)] if integer else counts[:0]
    step, origin = step_of(between), float(np.quantile(between, 0.5, method="lower")) if between.size else 0.0
    away = 4 * max(step, 1.0) if integer else 0.0
    level = np.nanmedian(counts[rest >= 0], axis=0) if (rest >= 0).any() else np.nanmin(counts, axis=0)

    def steps(part: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return second differences (over the root of 6), mean levels, and second differences of the force."""
        ok = (part[2:] >= 0) & (part[2:] == part[:-2])
        second = (counts[2:] - 2 * counts[1:-1] + counts[:-2])[ok] / np.sqrt(6)
        third = (counts[2:] + counts[1:-1] + counts[:-2])[ok] / 3
        force = (force_n[2:] - 2 * force_n[1:-1] + force_n[:-2])[ok] / np.sqrt(6)
        return second, third, force

    held, idle = steps(hold), steps(rest)
    # Levels in holds lie anywhere within a step; at rest they are all at one place of it.
    d, at, force = (
        held if len(held[0]) > 300 else tuple(np.concatenate(x) for x in zip(held, idle, strict=True))
    )
    inside, usual = np.zeros(d.shape, dtype=bool), 0.0
    for _ in range(_AWAY):
        # Clipped frames scatter less than the noise.
        some = (at > low + max(away, 4 * usual)) & (at < high - max(away, 4 * usual)) & np.isfinite(d)
        if not some.any():
            break
        inside, usual = some, _robust(d[some], step)
    above = np.maximum(at - level, 0.0)
    noise_of_force = _robust(force) if len(force) else 0.0
    if usual < np.hypot(C.smooth, np.sqrt(1 / 12)) * step and (
        found := noise_of_rounded(counts, hold, rest, level, step, origin, low, high)
    ):
        own = np.maximum(found.own, max(C.least_noise * float(np.nanmax(above, initial=1e-12)), 0.05 * step))
        return Noise(own, found.grows, step, low, high, noise_of_force, origin=origin, within=found.within)
    quiet = inside & (above < 20 * max(usual, 0.2 * step, 1e-12))
    loud = inside & (above > 20 * max(usual, 1e-12))
    variance = _robust(d[quiet], step) ** 2 if quiet.sum() > 50 else usual**2
    grows = 0.0
    if loud.sum() > 60:
        own, high_up = d[loud], above[loud]
        own, high_up = (x[np.abs(own) < 6 * np.sqrt(variance + (0.1 * high_up) ** 2)] for x in (own, high_up))
        more = float(np.mean(own**2) - variance)
        # Less is within the error of the estimate.
        if more > max(4 * variance * np.sqrt(2 / len(own) + 2 / (quiet.sum() + 1.0)), 0.1 * variance):
            grows = float(np.sqrt(more / np.mean(high_up**2)))
    sigma = max(
        sigma_before_rounding(variance, step),
        C.least_noise * float(np.nanmax(above, initial=1e-12)),
        0.05 * step,
    )
    own = np.full(counts.shape[1], sigma)
    for j in range(counts.shape[1]):
        mine = quiet[:, j] if quiet[:, j].sum() > 50 else inside[:, j]
        if mine.sum() > 50 and (found := _robust(d[mine, j], step)) > 1.5 * np.sqrt(variance):
            own[j] = max(sigma_before_rounding(found**2, step), sigma)
    noise = Noise(own, grows, step, low, high, noise_of_force, origin=origin)
    if (rest >= 0).sum() < _FEW_AT_REST or noise.coarse:
        return noise
    # There are many more frames at rest; their scatter gives the noise through the converter.
    found, error = _noise_at_rest(counts[rest >= 0], idle[0], noise)
    before = 1 / np.sqrt(2 * max(quiet.sum(), 1) / _SHARED)
    weight = error**-2 / (error**-2 + before**-2)
    change = float(np.exp(weight * np.log(found / noise.frame)))
    return replace(noise, sigma=change * own, within=float((error**-2 + before**-2) ** -0.5))


def _noise_at_rest(counts: FloatArray, second: FloatArray, noise: Noise) -> tuple[float, float]:
    """Estimate the noise from mean and scatter of each taxel at rest, with its relative standard error."""
    mean, variance = np.nanmean(counts, axis=0), np.array([_robust(d[np.isfinite(d)]) ** 2 for d in second.T])
    tried = noise.frame * np.geomspace(0.6, 1.6, 12)
    seen = np.empty((len(tried), len(mean)))
    for k, sigma in enumerate(tried):
        one = replace(noise, sigma=np.full(len(mean), sigma), grows=0.0)  # with the load, and here is none
        x, written, _, _ = one._table
        level = np.interp(mean, written, x) if len(x) else mean
        inside = (mean > written[0]) & (mean < written[-1]) if len(x) else np.zeros(len(mean), dtype=bool)
        seen[k] = one.variance(np.where(inside, level, mean)[None], np.ones(1))[0]
    own = np.array([np.interp(v, s, np.log(tried)) for v, s in zip(variance, seen.T, strict=True)])
    middle = float(np.median(own))
    # Standard error from the spread over taxels.
    return float(np.exp(middle)), max(1.25 * robust_sigma(own) / float(np.sqrt(len(own))), 1e-3)


def _robust(x: FloatArray, step: float = 0.0) -> float:
    """Return the standard deviation without outliers; the median absolute deviation alone would be quantised."""
    if not len(x):
        return 0.0
    size = np.abs(x)
    near = size <= 5 * max(robust_sigma(x, 0.0), float(np.quantile(size, 0.9)) / 1.645, step / 2)
    return float(np.sqrt(np.mean(x[near] ** 2)))


def clipped_at_rest(mean: FloatArray, low: float, sigma: float) -> BoolArray:
    """Return whether means at rest (J,) are those of noise about the lower bound."""
    return mean < low + 1.5 * max(sigma, 1e-12)
