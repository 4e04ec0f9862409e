"""The noise floor: what no model can explain, from frames in the hold, frames at rest, repeats, and the converter.

The noise sigma of a frame is that before rounding and clipping. What a frame shows of it depends on the value: at a
bound of the converter both the noise and the sensitivity shrink, which :class:`Whitening` takes into account.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from skincal.fit.observe import Readout, clipped_share, expected_counts, noise_from_rest
from skincal.gap.idle_noise import IdleNoise
from skincal.model.arrays import BoolArray, FloatArray, IntArray

ROUNDING_COUNTS = float(1 / np.sqrt(12))
"""Standard deviation of a value that was rounded to whole counts."""

CLIPPED, REPEATS, ASSUMED = "clipped rest", "repeats", "assumed"
"""Where noise was found: in what clipping makes of the level at rest, in exact repeats of presses, nowhere."""
LEFT_BY_FIT = "what the calibration's fit left"
"""Where no noise was found, it is taken to be no more than that."""

LEAST_COUNTS = 0.02
_MARGIN = 4.0
_FEWEST = 6
_DEGREE, _FRAMES_A_DEGREE = 6, 4
"""Of the polynomial that a hold follows, at most, and of how many frames it takes each degree."""
_STRAIGHT = 0.01
"""Chance of the bends that are left from which on they are noise."""
_WILD = 4.0
"""A hold that scatters by so much more than the others is a glitch."""
_USUAL = 0.999
"""A group scatters by less than this part of groups do, or is left out."""
_WIDTH = 1.96
"""Standard errors of half an interval of 95 %."""
_AGREE = 3.0
"""Estimates further apart than so many standard errors are not of the same noise."""
_RESAMPLES = 200
NORMAL = 1.4826
"""Standard deviation of normal errors over the median of their sizes."""
_NOISY, _SURE, _KNOWN = 1.5, 5.0, 100.0
"""A taxel is noisy if it scatters by so much more than the middle one, that is so many standard errors, and it has been
seen with so many degrees of freedom."""
_NOISE_STEP = 0.1
"""Noise of noisy taxels is told in steps of so much of its logarithm: a tenth."""


@dataclass(frozen=True)
class NoiseFloor:
    """Noise of a session [counts]; intervals hold 95 %.

    Attributes:
        frame_counts: of a frame, before rounding and clipping.
        frame_interval: where that lies.
        frame_from: ``hold and idle frames``, ``hold frames``, ``idle frames``, ``clipped rest``, ``hold means``,
            ``assumed``, or that of the mean.
        mean_counts: of a hold mean.
        mean_interval: where that lies.
        mean_from: ``repeats``, ``what the calibration's fit left``, or how the frame's noise was found.
        repeat_counts: by how much hold means of exact repeats differ beyond what place and force explain to first
            order, as of one of them: a bound from above, NaN where there are no repeats. Where presses do not come
            back to the same place within a few tenths of a millimetre it is far above the noise.
        repeat_interval: where that lies.
        rounding_counts: that rounding adds to a frame; zero where values are not whole numbers.
        taxel_counts: of a frame, before rounding and clipping, for each taxel, where some are far noisier than usual;
            ``frame_counts`` is that of the usual ones then. Empty where all are alike.
        measured: whether anything in the data shows the noise, or bounds it.
    """

    frame_counts: float
    frame_interval: tuple[float, float]
    frame_from: str
    mean_counts: float
    mean_interval: tuple[float, float]
    mean_from: str
    rounding_counts: float
    repeat_counts: float = float("nan")
    repeat_interval: tuple[float, float] = (float("nan"), float("nan"))
    taxel_counts: tuple[float, ...] = ()
    measured: bool = True

    @property
    def sigma_counts(self) -> float | FloatArray:
        """Noise of a frame: one for all taxels, or (J,)."""
        return np.array(self.taxel_counts) if self.taxel_counts else self.frame_counts

    def of_means(self, mean_counts: float, interval: tuple[float, float], found_in: str) -> NoiseFloor:
        """The floor of a session of hold means alone, each an observation that is worth one frame [counts]."""
        return replace(
            self,
            frame_counts=mean_counts,
            frame_interval=interval,
            frame_from=found_in,
            mean_counts=mean_counts,
            mean_interval=interval,
            mean_from=found_in,
        )

    def with_repeats_of(self, other: NoiseFloor) -> NoiseFloor:
        """The same with what another floor of the session says of its repeats."""
        return replace(self, repeat_counts=other.repeat_counts, repeat_interval=other.repeat_interval)

    def by_taxel(self, noisy_counts: FloatArray) -> NoiseFloor:
        """The same with the noise (J,) of taxels that are noisier than usual [counts]; NaN for the usual ones."""
        own = np.fmax(noisy_counts, self.frame_counts)
        return replace(self, taxel_counts=tuple(own.tolist())) if (own > self.frame_counts).any() else self


def rounding(readout: Readout) -> float:
    """What rounding adds to the noise of a frame [counts]."""
    return ROUNDING_COUNTS if readout.integer else 0.0


def assumed_floor(readout: Readout, frame_counts: float = 1.0, hold_frames: float = 25.0) -> NoiseFloor:
    """The floor of a session that has not been recorded."""
    mean = float(np.hypot(frame_counts, rounding(readout)) / np.sqrt(hold_frames))
    frame = (0.5 * frame_counts, 2 * frame_counts)
    return NoiseFloor(
        frame_counts,
        frame,
        ASSUMED,
        mean,
        (mean / 2, mean * 2),
        ASSUMED,
        rounding(readout),
        measured=False,
    )


def frame_scatter(counts: FloatArray, group: IntArray, readout: Readout) -> tuple[FloatArray, FloatArray]:
    """Squares and degrees of freedom (G,) of the scatter of frames about a smooth curve, group by group.

    A skin that relaxes, or whose rate of loading fades, leaves no straight line in a hold.

    Args:
        counts: (M, J) frames in the hold.
        group: (M,) the hold that each belongs to, -1 for none.
        readout: taxels near its bounds do not count.
    """
    left: list[float] = []
    bends: list[FloatArray] = []
    sizes: list[tuple[int, int, int]] = []
    held = counts[group >= 0]
    # A taxel that never changes while others do is stuck: it has no noise to show.
    lively = np.fmax.reduce(held, axis=0, initial=-np.inf) > np.fmin.reduce(held, axis=0, initial=np.inf)
    lively |= not lively.any()
    for number in np.unique(group[group >= 0]):
        values = counts[group == number]
        if len(values) < _FEWEST:
            continue
        inside = lively & np.isfinite(values).all(axis=0)
        inside &= values.min(axis=0, initial=np.inf) > (
            -np.inf if readout.value_min is None else readout.value_min + _MARGIN
        )
        inside &= values.max(axis=0, initial=-np.inf) < (
            np.inf if readout.value_max is None else readout.value_max - _MARGIN
        )
        if not inside.any():
            continue
        degree = min(_DEGREE, len(values) // _FRAMES_A_DEGREE)
        curves = np.linalg.qr(legvander(np.linspace(-1.0, 1.0, len(values)), degree))[0]
        parts = curves.T @ values[:, inside]
        left.append(float(((values[:, inside] - curves @ parts) ** 2).sum()))
        bends.append(np.pad((parts**2).sum(axis=1), (0, _DEGREE - degree)))
        sizes.append((len(values), degree, int(inside.sum())))
    if not left:
        return np.zeros(0), np.zeros(0)
    frames, degrees, taxels = np.array(sizes).T
    return _about_curves(np.array(left), np.array(bends), frames, degrees, taxels)


def noisy_taxels(counts: FloatArray, group: IntArray, readout: Readout) -> FloatArray:
    """Noise of a frame (J,) of taxels that are far noisier than usual [counts]; NaN for the usual ones.

    A loose contact, or an amplifier of its own, and a few taxels scatter several times as much as the others. With one
    noise for all they would hide what the others show. One that scatters *less* than usual keeps the usual noise: it
    may be stuck.

    Args:
        counts: (M, J) frames in the hold.
        group: (M,) the hold that each belongs to, -1 for none.
        readout: the converter.
    """
    squares: list[FloatArray] = []
    freedom: list[FloatArray] = []
    low = -np.inf if readout.value_min is None else readout.value_min + _MARGIN
    high = np.inf if readout.value_max is None else readout.value_max - _MARGIN
    for number in np.unique(group[group >= 0]):
        values = counts[group == number]
        if len(values) < _FEWEST:
            continue
        inside = np.isfinite(values).all(axis=0)
        inside &= (values.min(axis=0) > low) & (values.max(axis=0) < high)
        degree = min(_DEGREE, len(values) // _FRAMES_A_DEGREE)
        curves = np.linalg.qr(legvander(np.linspace(-1.0, 1.0, len(values)), degree))[0]
        left = values - curves @ (curves.T @ values)
        squares.append(np.where(inside, (left**2).sum(axis=0), 0.0))
        freedom.append(np.where(inside, float(len(values) - 1 - degree), 0.0))
    usual = np.full(counts.shape[1], np.nan)
    if not squares:
        return usual
    found, apart, error = usual.copy(), usual.copy(), np.full_like(usual, np.inf)
    for taxel, (of, free) in enumerate(zip(np.array(squares).T, np.array(freedom).T, strict=True)):
        of, free = of[free > 0], free[free > 0]
        if free.sum() >= _KNOWN and len(free) > 1:
            found[taxel] = _robust_deviation(of, free)
            # A long hold may weigh more than all others together, and be a glitch: they must say it, too.
            others = np.arange(len(free)) != np.argmax(of / free)
            apart[taxel] = _robust_deviation(of[others], free[others])
            error[taxel] = apart[taxel] / np.sqrt(2 * free[others].sum())
    # Of a quiet taxel rounding makes anything up to half a count, as its level lies.
    least = max(_NOISY * _middle(found), 2 * rounding(readout))
    noisy = (apart > least) & (apart - _middle(found) > _SURE * error)
    # In steps, so that many taxels share a noise.
    steps = np.round(np.log(np.where(noisy, found, 1.0)) / _NOISE_STEP) * _NOISE_STEP
    alone = [_without(float(value), rounding(readout)) for value in np.exp(steps)]
    return np.where(noisy, alone, np.nan)


def _about_curves(
    left: FloatArray, bends: FloatArray, frames: IntArray, degrees: IntArray, taxels: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Squares and degrees of freedom (G,) about the simplest curve that the holds together allow.

    A curve of a higher degree than there is leaves less to tell the noise from.

    Args:
        left: (G,) squares about the highest degree.
        bends: (G, 1 + degree) squares that each degree explains.
        frames: (G,) of each hold.
        degrees: (G,) the highest of each hold.
        taxels: (G,) that each looks at.
    """
    freedom = ((frames - 1 - degrees) * taxels).astype(np.float64)
    # A glitch has no say in what the others look like.
    scatter, least = left / freedom, LEAST_COUNTS**2
    usual = scatter <= _WILD * max(float(np.median(scatter)), least)
    noise, whole = max(float(left[usual].sum() / freedom[usual].sum()), least), float(freedom[usual].sum())

    def beyond(degree: int) -> tuple[FloatArray, IntArray]:
        return bends[:, degree + 1 :].sum(axis=1), np.maximum(degrees - degree, 0) * taxels

    def enough(degree: int) -> bool:
        more, spare = (float(of[usual].sum()) for of in beyond(degree))
        return spare == 0 or float(f_distribution.sf(more / spare / noise, spare, whole)) > _STRAIGHT

    more, spare = beyond(next(filter(enough, range(1, _DEGREE)), _DEGREE))
    return left + more, freedom + spare


def force_scatter(force_n: FloatArray, group: IntArray) -> float:
    """Standard deviation of the measured force of a frame in a hold [N]: median of the holds, zero without any.

    Args:
        force_n: (M,) of frames.
        group: (M,) the hold that each belongs to, -1 for none.
    """
    found: list[float] = []
    for number in np.unique(group[group >= 0]):
        values = force_n[group == number]
        if len(values) < _FEWEST or not np.isfinite(values).all():
            continue
        # Differences of neighbours: the force may drift within a hold, and the skin feels that.
        found.append(float(np.sqrt((np.diff(values) ** 2).mean() / 2)))
    return float(np.median(found)) if found else 0.0


def plateau_scatter(means: FloatArray, force_n: FloatArray) -> float:
    """Noise of a hold mean, from how far each lies off the line through the two about it; NaN with too few [counts].

    On a staircase of uniform pressure nothing is at rest, and no press is repeated; but a curve, also one that differs
    on the way down, is nearly straight over three plateaus. Where the staircase turns it is not.

    Args:
        means: (P, J) hold means, in the order of time.
        force_n: (P,) of the same holds.
    """
    first, here, last = force_n[:-2], force_n[1:-1], force_n[2:]
    inside = (here - first) * (last - here) > 0
    if inside.sum() < _FEWEST:
        return float("nan")
    share = ((here - first)[inside] / (last - first)[inside])[:, None]
    off = means[1:-1][inside] - (1 - share) * means[:-2][inside] - share * means[2:][inside]
    sizes = np.abs(off / np.sqrt(1 + share**2 + (1 - share) ** 2))
    # Of each taxel its own middle, so that those that jump do not count for more.
    middle = np.nanmedian(sizes[:, np.isfinite(sizes).any(axis=0)], axis=0)
    return float(NORMAL * np.median(middle[middle > 0])) if (middle > 0).any() else float("nan")


def repeat_scatter(
    means: FloatArray, first: IntArray, second: IntArray, slopes: FloatArray, use: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Squares and degrees of freedom of differences of exact repeats, what a place and a force explain left out.

    Args:
        means: (P, J) hold means.
        first: (R,) rows of presses.
        second: (R,) rows of their repeats.
        slopes: (P, J, 3) of the image by place and force.
        use: (P, J) taxels away from the bounds.

    Returns:
        Both (R,), as of one hold mean: half of the squares of the difference.
    """
    squares, freedom = np.zeros(len(first)), np.zeros(len(first))
    for i, (a, b) in enumerate(zip(first, second, strict=True)):
        taxels = use[a] & use[b] & np.isfinite(means[a] + means[b])
        if taxels.sum() <= 3:
            continue
        basis = np.linalg.qr(slopes[a][taxels])[0]
        difference = means[a][taxels] - means[b][taxels]
        difference = difference - basis @ (basis.T @ difference)
        squares[i] = float((difference**2).sum()) / 2
        freedom[i] = float(taxels.sum() - 3)
    return squares, freedom


def pooled(
    squares: FloatArray, freedom: FloatArray, rng: np.random.Generator
) -> tuple[float, tuple[float, float]]:
    """Standard deviation of groups pooled robustly, and its interval by drawing groups again.

    A glitch in one group must not raise the floor: groups far above the weighted median of the variances are left
    out, and the mean of the others is taken, which is nearer to the truth than the median.
    """
    keep = freedom > 0
    squares, freedom = squares[keep], freedom[keep]
    if not len(squares):
        return float("nan"), (float("nan"), float("nan"))
    best = _robust_deviation(squares, freedom)
    drawn = rng.integers(0, len(squares), (_RESAMPLES, len(squares)))
    again = [_robust_deviation(squares[d], freedom[d]) for d in drawn]
    low, high = np.quantile(again, [0.025, 0.975])
    return best, (float(min(low, best)), float(max(high, best)))


def _robust_deviation(squares: FloatArray, freedom: FloatArray) -> float:
    """The groups' mean variance, without those that scatter more than chance lets one in a thousand."""
    variance = squares / freedom
    order = np.argsort(variance)
    weight = np.cumsum(freedom[order])
    middle = variance[order][np.searchsorted(weight, weight[-1] / 2)]
    # The median of a chi-square over its mean, for the usual number of degrees of freedom.
    middle /= (1 - 2 / (9 * float(np.median(freedom)))) ** 3
    kept = variance <= middle * chi2.ppf(_USUAL, freedom) / freedom
    return float(np.sqrt(squares[kept].sum() / freedom[kept].sum()))


def noise_floor(
    frames: tuple[FloatArray, FloatArray],
    repeats: tuple[FloatArray, FloatArray],
    rest_means: FloatArray,
    rest_scatter: float,
    hold_frames: float,
    readout: Readout,
    rng: np.random.Generator,
    idle: IdleNoise | None = None,
) -> NoiseFloor:
    """The floor from all there is.

    Frames in the hold and idle ones are taken together where they agree. Where they do not, something drifts at rest
    or grows with the load, and the hold is what residuals are measured in.

    Args:
        frames: of ``frame_scatter``; empty where there are no frames.
        repeats: of ``repeat_scatter``; empty where there are none.
        rest_means: (J,) mean counts of untouched taxels, which clipping lifts; NaN where not known.
        rest_scatter: of hold means of untouched taxels [counts]; NaN where not known.
        hold_frames: frames of a hold mean; 1 where not known.
        readout: the converter.
        rng: for intervals.
        idle: what idle frames say; None: nothing.
    """
    added = rounding(readout)
    frame, interval = pooled(*frames, rng)
    source = "hold frames"
    if np.isfinite(frame):
        frame, *ends = (_without(value, added) for value in (frame, *interval))
        interval = (ends[0], ends[1])
        # Few holds, drawn again, scatter by less than what is to be known of them.
        least = frame / float(np.sqrt(2 * max(frames[1].sum(), 1.0)))
        error = max((interval[1] - interval[0]) / (2 * _WIDTH), least)
        interval = min(interval[0], frame - _WIDTH * least), max(interval[1], frame + _WIDTH * least)
        if idle is not None and idle.known:
            both = float(np.hypot(error, idle.error_counts))
            if abs(frame - idle.sigma_counts) < _AGREE * both:
                share = (idle.error_counts / both) ** 2
                frame = share * frame + (1 - share) * idle.sigma_counts
                interval, source = _about(frame, error * idle.error_counts / both), "hold and idle frames"
    elif idle is not None and idle.known:
        frame, interval = idle.sigma_counts, _about(idle.sigma_counts, idle.error_counts)
        source = "idle frames"
    elif np.isfinite(frame := noise_from_rest(_middle(rest_means), readout)):
        source = CLIPPED
        drawn = rng.integers(0, len(rest_means), (_RESAMPLES, len(rest_means)))
        low, high = np.quantile([_middle(rest_means[d]) for d in drawn], [0.025, 0.975])
        ends = [noise_from_rest(float(end), readout) for end in (low, high)]
        interval = (float(np.fmin(ends[0], frame)), float(np.fmax(ends[1], frame)))
    else:
        known = np.isfinite(rest_scatter) and rest_scatter > 0
        frame, source = (float(rest_scatter), "hold means") if known else (1.0, ASSUMED)
        interval = (0.5 * frame, 2.0 * frame)
    repeat, repeat_interval = pooled(*repeats, rng)
    mean, *ends = (float(np.hypot(v, added) / np.sqrt(hold_frames)) for v in (frame, *interval))
    mean_interval, mean_from = (ends[0], ends[1]), source
    # Repeats that read the very same show no noise, but copies, or a simulator without any.
    known = source != ASSUMED
    if repeat > LEAST_COUNTS and (repeat < mean or not known) and "frames" not in source:
        mean, mean_interval, mean_from = repeat, repeat_interval, REPEATS
    return NoiseFloor(
        frame,
        interval,
        source,
        mean,
        mean_interval,
        mean_from,
        added,
        repeat,
        repeat_interval,
        measured=mean_from != ASSUMED,
    )


def _about(value: float, error: float) -> tuple[float, float]:
    return value - _WIDTH * error, value + _WIDTH * error


def _middle(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def _without(deviation: float, added: float) -> float:
    return float(np.sqrt(max(deviation**2 - added**2, LEAST_COUNTS**2)))


@dataclass(frozen=True)
class Whitening:
    """What a change of a value is worth in standard deviations of what is read.

    Attributes:
        sigma_counts: noise of one frame, before rounding and clipping.
        readout: the converter.
    """

    sigma_counts: float
    readout: Readout

    def weight(self, values: FloatArray, frames: FloatArray) -> FloatArray:
        """Weights (N, J) [1/counts] of observations.

        Args:
            values: (N, J) values before the converter [counts].
            frames: (N,) frames that each is the mean of.
        """
        worth = np.interp(values, self._table[0], self._table[1])
        return worth * np.sqrt(frames)[:, None]

    @cached_property
    def _table(self) -> tuple[FloatArray, FloatArray]:
        """Slope of the mean count over its standard deviation, at values about the bounds."""
        sigma, readout = self.sigma_counts, self.readout
        full = float(np.hypot(sigma, rounding(readout)))
        bounds = [b for b in (readout.value_min, readout.value_max) if b is not None]
        near = np.linspace(-5.0, 5.0, 41) * max(sigma, 0.2)
        knots = np.unique(np.concatenate([[0.0], *(b + near for b in bounds)]))
        step = 0.05 * sigma
        slope = (
            expected_counts(knots + step, sigma, readout) - expected_counts(knots - step, sigma, readout)
        ) / (2 * step)
        share = np.array([clipped_share(float(k), sigma, readout) for k in knots])
        return knots, np.clip(slope, 0.0, 1.0) / (full * np.maximum(share, 0.2))
