"""Noise of a session, and what the converter makes of a level: its mean, its slope and its scatter.

A frame is ``round(level + noise)`` in steps of the converter, clipped. Its mean and scatter as functions of
the level are
worked out once, as a table. Where the noise is small against a step, the rounding error of a hold is the same in all
its frames: that part does not average out, and is kept apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from skincal.inference.constants import CONSTANTS as C
from skincal.model.arrays import BoolArray, FloatArray, IntArray

_KNOTS = 4000
_NEAR = 8.0


@dataclass(frozen=True, eq=False)
class Noise:
    """What a frame scatters by.

    Attributes:
        sigma: (J,) standard deviation before rounding, of a level at rest [counts].
        grows: part of the level above rest that is added to it, in quadrature.
        step: of the converter [counts]; 0 for values that are not rounded.
        low: where the converter clips [counts]; -inf if it does not, or not known.
        high: the same above.
        force_n: noise of the measured force of a frame [N].
    """

    sigma: FloatArray
    grows: float
    step: float
    low: float
    high: float
    force_n: float = 0.0

    @cached_property
    def frame(self) -> float:
        """Of the middle taxel [counts]."""
        return float(np.median(self.sigma))

    @cached_property
    def _kept(self) -> float:
        """Variance of rounding that all frames of a level share [counts²]."""
        return shared_rounding(self.frame, self.step)

    @cached_property
    def _table(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Levels near the bounds, and mean, slope and variance of what is written there."""
        sd, step = max(self.frame, 1e-9), self.step
        around = _NEAR * np.hypot(sd, step)
        ends = [e for e in (self.low, self.high) if np.isfinite(e)]
        levels, means, variances = [], [], []
        for end in ends:
            x = np.linspace(end - around, end + around, _KNOTS)
            if step:
                k = end + step * np.arange(-np.ceil(around / step) - 2, np.ceil(around / step) + 3)
                share = np.diff(ndtr((k[None] + step / 2 - x[:, None]) / sd), axis=1, prepend=0)
            else:
                k = np.linspace(end - around, end + around, 400)
                share = np.diff(ndtr((k[None] - x[:, None]) / sd), axis=1, prepend=0)
            share[:, 0] += 0.0
            share[:, -1] += 1 - share.sum(axis=1)
            written = np.clip(k, self.low, self.high)
            mean = share @ written
            variance = share @ written**2 - (share @ written) ** 2
            if self._kept > C.rounding * self.frame**2:
                # Steps that the noise does not blur: the mean over where a level may lie within its step.
                wide = max(int(step / (x[1] - x[0])), 1)
                box = np.ones(wide) / wide
                mean = np.convolve(np.pad(mean, wide, mode="reflect", reflect_type="odd"), box, "same")[
                    wide:-wide
                ]
                variance = np.convolve(np.pad(variance, wide, mode="edge"), box, "same")[wide:-wide]
            levels.append(x)
            means.append(mean)
            variances.append(variance)
        if not ends:
            return np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0)
        x, m, v = (np.concatenate(own) for own in (levels, means, variances))
        order = np.argsort(x, kind="stable")
        x, m, v = x[order], m[order], v[order]
        return x, m, np.gradient(m, np.maximum.accumulate(x + 1e-9 * np.arange(len(x)))), v

    def written(self, level: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean of what is written, and its slope, for levels of any shape [counts]."""
        x, m, slope, _ = self._table
        mean, steep = level.copy(), np.ones_like(level)
        if len(x):
            around = _NEAR * float(np.hypot(max(self.frame, 1e-9), self.step))
            for end in (e for e in (self.low, self.high) if np.isfinite(e)):
                near = np.abs(level - end) < around
                mean[near] = np.interp(level[near], x, m)
                steep[near] = np.interp(level[near], x, slope)
            mean = np.clip(mean, self.low, self.high)
            steep[(level <= self.low - around) | (level >= self.high + around)] = 0.0
        return mean, np.clip(steep, C.least_slope, 1.0)

    def variance(self, level: FloatArray, rest: float, frames: FloatArray) -> FloatArray:
        """Variance (N, J) of means over frames (N,) at levels (N, J) [counts²]."""
        x, _, _, v = self._table
        own = np.broadcast_to(self.sigma**2 + self.step**2 / 12, level.shape).copy()
        if len(x):
            around = _NEAR * float(np.hypot(max(self.frame, 1e-9), self.step))
            usual = self.frame**2 + self.step**2 / 12
            for end in (e for e in (self.low, self.high) if np.isfinite(e)):
                near = np.abs(level - end) < around
                own[near] *= np.interp(level[near], x, v) / usual
            own[(level <= self.low - around) | (level >= self.high + around)] = 0.0
            own = np.maximum(own, C.least_variance * usual)
        own += (self.grows * np.maximum(level - rest, 0.0)) ** 2
        return np.maximum(own - self._kept, 0.2 * own) / frames[:, None] + self._kept


def shared_rounding(sigma: float, step: float) -> float:
    """Variance of the mean of a rounded, noisy level over where the level may lie within its step [counts²].

    The Fourier series of the rounding error, each wave shrunk by the noise.
    """
    if not step:
        return 0.0
    k = np.arange(1, 7)
    waves = step / (np.pi * k) * np.exp(-2 * (np.pi * k * sigma / step) ** 2)
    return float((waves**2).sum() / 2)


def sigma_before_rounding(variance: float, step: float) -> float:
    """Noise whose frames, rounded in steps, scatter by a variance about their mean, levels lying anywhere."""
    low, high = 0.0, float(np.sqrt(max(variance, 0.0))) + step
    for _ in range(50):
        middle = (low + high) / 2
        seen = middle**2 + step**2 / 12 - shared_rounding(middle, step)
        low, high = (middle, high) if seen < variance else (low, middle)
    return (low + high) / 2


def step_of(counts: FloatArray) -> float:
    """Step in which values come; 0 where they are no multiples of one."""
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
    """Finds the noise from frames that follow each other.

    Args:
        counts: (M, J) frames.
        hold: (M,) the hold that each belongs to, -1 for none.
        rest: (M,) the stretch of rest that each belongs to, -1 for none.
        force_n: (M,) measured force.
        low: where the converter clips; -inf if it does not.
        high: the same above.
        integer: whether values are whole numbers.
    """
    step = step_of(counts) if integer else 0.0
    away = 4 * max(step, 1.0) if integer else 0.0
    level = np.nanmedian(counts[rest >= 0], axis=0) if (rest >= 0).any() else np.nanmin(counts, axis=0)

    def steps(part: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Second differences (over the root of 6), mean levels, and force's, of frames in a row."""
        ok = (part[2:] >= 0) & (part[2:] == part[:-2])
        second = (counts[2:] - 2 * counts[1:-1] + counts[:-2])[ok] / np.sqrt(6)
        third = (counts[2:] + counts[1:-1] + counts[:-2])[ok] / 3
        force = (force_n[2:] - 2 * force_n[1:-1] + force_n[:-2])[ok] / np.sqrt(6)
        return second, third, force

    held, idle = steps(hold), steps(rest)
    # Levels in holds lie anywhere within a step of the converter; at rest they are all the same.
    d, at, force = (
        held if len(held[0]) > 300 else tuple(np.concatenate(x) for x in zip(held, idle, strict=True))
    )
    inside = (at > low + away) & (at < high - away) & np.isfinite(d)
    above = np.maximum(at - level, 0.0)
    usual = _robust(d[inside], step) if inside.any() else 0.0
    quiet = inside & (above < 20 * max(usual, 0.2 * step, 1e-12))
    loud = inside & (above > 20 * max(usual, 1e-12))
    variance = _robust(d[quiet], step) ** 2 if quiet.sum() > 50 else usual**2
    grows = 0.0
    if loud.sum() > 60:
        own, high_up = d[loud], above[loud]
        own, high_up = (x[np.abs(own) < 6 * np.sqrt(variance + (0.1 * high_up) ** 2)] for x in (own, high_up))
        more = float(np.mean(own**2) - variance)
        # Too little is not told from the scatter of the estimate.
        if more > max(4 * variance * np.sqrt(2 / len(own) + 2 / (quiet.sum() + 1.0)), 0.1 * variance):
            grows = float(np.sqrt(more / np.mean(high_up**2)))
    before = sigma_before_rounding(variance, step)
    sigma = max(before, C.least_noise * float(np.nanmax(above, initial=1e-12)), 0.05 * step)
    own = np.full(counts.shape[1], sigma)
    for j in range(counts.shape[1]):
        mine = quiet[:, j] if quiet[:, j].sum() > 50 else inside[:, j]
        if mine.sum() > 50 and (found := _robust(d[mine, j], step)) > 1.5 * np.sqrt(variance):
            own[j] = max(sigma_before_rounding(found**2, step), sigma)
    return Noise(own, grows, step, low, high, _robust(force) if len(force) else 0.0)


def _robust(x: FloatArray, step: float = 0.0) -> float:
    """Standard deviation of values, those far out left aside; the median alone would be that of steps."""
    if not len(x):
        return 0.0
    size = np.abs(x)
    rough = 1.4826 * float(np.median(size))
    near = size <= 5 * max(rough, float(np.quantile(size, 0.9)) / 1.645, step / 2)
    return float(np.sqrt(np.mean(x[near] ** 2)))


def rest_level(mean: FloatArray, noise: Noise) -> FloatArray:
    """Levels of which clipped noise makes means (J,)."""
    x, m, _, _ = noise._table
    if not len(x):
        return mean
    near = np.abs(mean - noise.low) < _NEAR * np.hypot(noise.frame, noise.step)
    return np.where(near, np.interp(mean, m, x), mean)


def clipped_at_rest(mean: FloatArray, low: float, sigma: float) -> BoolArray:
    """Whether means at rest (J,) are what noise about a bound leaves."""
    return mean < low + 1.5 * max(sigma, 1e-12)
