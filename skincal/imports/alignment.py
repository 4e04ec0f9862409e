"""The offset of two clocks, estimated by correlation of the force with the taxels. Pure numerics.

The masked normalised cross-correlation of the force with the activity of the taxels gives the lag to one step of a
common grid. The lag is then refined by interpolation, and estimated again in parts of the recording. The scatter of
these is the uncertainty. If they follow a line, the clocks run at different rates, and the line is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np

from skincal.imports.clock import usual_step
from skincal.imports.recording import BoolArray, FloatArray
from skincal.statistics import robust_sigma

LEAST_OVERLAP: Final = 0.5
"""Smallest overlap of the recordings, as a part of the shorter one, at which lags are searched."""

LEAST_CORRELATION: Final = 0.6
"""Correlation below which the recordings do not show the same contacts (set by eye; random traces reach 0.3)."""

ALIKE: Final = 1.2
"""Another lag is equally good if its residual variance is at most this times that of the best one."""

MOST_RATE: Final = 0.05
"""Largest relative difference of two clocks' rates that is searched; oscillators without a crystal are off by 2 %."""

_NOTHING: Final = (0.0, np.zeros(0), np.zeros(0), np.zeros(0), "")
PARTS: Final = 12
SIGMAS: Final = 4.0
MOST_SAMPLES: Final = 1 << 20


class NoOffsetError(ValueError):
    """The recordings do not determine the offset of their clocks; the text says why."""


class _UnlikeError(NoOffsetError):
    """At no lag the recordings are alike."""


@dataclass(frozen=True, eq=False)
class JoinedClock:
    """Alignment of a file's clock with that of the taxels: ``t + offset_s + rate (t - middle_s)``.

    Attributes:
        name: of the file's table in the mapping.
        offset_s: time added to the file's times [s].
        sigma_s: standard deviation of the offset [s]; NaN if it was given.
        rate: relative rate by which the clock of the taxels runs faster; 0 if unknown.
        middle_s: time at which the rate has no influence [s].
        estimated: whether the offset was found by correlation.
        by: the column that was correlated, or the first of those with the taxels.
        lags_s: lags around the best [s], shape (n,); empty without an estimate.
        correlations: at these lags, shape (n,).
        time_s: times of the two traces below, on the clock of the taxels [s], shape (m,).
        traces: activity of the taxels, and the column, each relative to its range, shape (2, m).
    """

    name: str
    offset_s: float
    sigma_s: float = np.nan
    rate: float = 0.0
    middle_s: float = 0.0
    estimated: bool = False
    by: str = ""
    correlation: float = np.nan
    lags_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    correlations: FloatArray = field(default_factory=lambda: np.zeros(0))
    time_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    traces: FloatArray = field(default_factory=lambda: np.zeros((2, 0)))

    def onto(self, time_s: FloatArray) -> FloatArray:
        """Return times of the file on the clock of the taxels."""
        return time_s + self.offset_s + self.rate * (time_s - self.middle_s)

    def after(self, rate: float, zero_s: float) -> JoinedClock:
        """Return the alignment of times that it takes only when they are stretched about ``zero_s`` by a rate."""
        middle = zero_s + (self.middle_s - zero_s) / (1 + rate)
        total, offset = (1 + rate) * (1 + self.rate) - 1, self.middle_s + self.offset_s - middle
        return replace(self, offset_s=offset, rate=total, middle_s=middle)


def activities(images: FloatArray) -> list[FloatArray]:
    """Return signals that follow the force, each (M,): the sum of the taxels, and their distance from rest.

    The second serves sensors with channels of different signs. A signal that never changes is left out.
    """
    images = images[:, np.isfinite(images).any(axis=0)]  # without taxels that were never read
    rest = np.nanmedian(images, axis=0)
    apart = np.nan_to_num(images - rest)
    return [one for one in (apart.sum(axis=1), np.abs(apart).sum(axis=1)) if np.ptp(one) > 0]


def estimate_offset(
    name: str,
    taxels_s: FloatArray,
    images: FloatArray,
    file_s: FloatArray,
    columns: Mapping[str, FloatArray],
    within_s: float = np.inf,
) -> JoinedClock:
    """Return the estimated alignment of a file's clock.

    Args:
        name: name of the file.
        taxels_s: times of the taxels, ascending [s], shape (M,).
        images: their readings, shape (M, J).
        file_s: times of the file, ascending [s], shape (n,).
        columns: force or positions of the file, each (n,); the column with the best correlation is used.
        within_s: largest offset that is searched [s]; evenly spaced presses need such a bound.

    Raises:
        NoOffsetError: no column correlates with the taxels, or several offsets are equally good.
    """
    try:
        return _estimated(name, taxels_s, images, file_s, columns, within_s)
    except _UnlikeError:
        rate = _likely_rate(taxels_s, images, file_s, columns)
        if not rate:
            raise
        stretched = file_s[0] + (1 + rate) * (file_s - file_s[0])
        found = _estimated(name, taxels_s, images, stretched, columns, within_s)
        return found.after(rate, float(file_s[0]))


def _likely_rate(
    taxels_s: FloatArray, images: FloatArray, file_s: FloatArray, columns: Mapping[str, FloatArray]
) -> float:
    """Return the relative difference of rates at which a column correlates best with the taxels.

    Rates differ by as much from each other as moves the ends of the recording by the length of a contact.
    """
    best, taxels_s, file_s = (0.0, 0.0), taxels_s - taxels_s[0], file_s - file_s[0]
    for activity in activities(images):
        length = _length(taxels_s, activity)
        step = max(common_step(taxels_s, file_s), length / 8)
        many = int(np.ceil(MOST_RATE * float(file_s[-1]) / length))
        for given, values in varying(columns).values():
            for rate in np.linspace(-MOST_RATE, MOST_RATE, 2 * many + 1).tolist():
                found = _correlations(taxels_s, activity, (1 + rate) * file_s[given], values, step)[1]
                best = max(best, (float(np.nanmax(np.abs(found), initial=0.0)), rate))
    return best[1]


def varying(columns: Mapping[str, FloatArray]) -> dict[str, tuple[BoolArray, FloatArray]]:
    """Return which rows of columns (n,) are measured, and their values, for columns in which anything changes."""
    given = {name: (np.isfinite(values), values[np.isfinite(values)]) for name, values in columns.items()}
    return {name: part for name, part in given.items() if len(part[1]) > 2 and np.ptp(part[1]) > 0}


def _length(time_s: FloatArray, values: FloatArray) -> float:
    """Return the lag [s] at which the correlation of a signal (n,) with itself has fallen to a half."""
    step = common_step(time_s)
    even = np.interp(np.arange(time_s[0], time_s[-1], step), time_s, values)
    even = even - even.mean()
    own = convolved(even, even[::-1])[len(even) - 1 :]
    return step * max(int(np.argmax(own < own[0] / 2)), 1)


def _estimated(
    name: str, taxels_s: FloatArray, images: FloatArray, file_s: FloatArray, columns: Mapping[str, FloatArray],
    within_s: float,
) -> JoinedClock:  # fmt: skip
    """Return what :func:`estimate_offset` does, for clocks of nearly the same rate."""
    # Subtract the start: seconds since 1970 would cost the search the last digits.
    zeros = float(taxels_s[0]), float(file_s[0])
    apart = zeros[0] - zeros[1]
    taxels_s, file_s = taxels_s - zeros[0], file_s - zeros[1]
    step = common_step(taxels_s, file_s)
    every: list[tuple[float, FloatArray, FloatArray, FloatArray, str]] = []
    for activity in activities(images):
        for column, (given, values) in varying(columns).items():
            lags, found = _correlations(taxels_s, activity, file_s[given], values, step)
            found[np.abs(lags + apart) > within_s] = np.nan
            every.append((float(np.nanmax(np.abs(found), initial=0.0)), lags, found, activity, column))
    peak, lags, found, activity, column = max(every, key=lambda one: one[0], default=_NOTHING)
    if peak < LEAST_CORRELATION:
        reached = f"a correlation of {peak:.2f} at most" if every else "nothing in it changes"
        raise _UnlikeError(f"no lag at which {', '.join(columns)} correlates with the taxels ({reached})")
    at = best_lag(lags + apart, np.abs(found))
    if within_s - abs(lags[at] + apart) < step:
        raise NoOffsetError(f"the correlation is largest at the bound of {within_s:g} s (within_s)")
    given = np.isfinite(columns[column])
    file_s, values = file_s[given], columns[column][given] * np.sign(found[at])
    offset, correlation = _refined(taxels_s, activity, file_s, values, float(lags[at]), 2 * step)
    sigma, rate, middle, offset = _parts(taxels_s, activity, file_s, values, offset, step)
    near = np.abs(lags - offset) < 10 * max(step, (taxels_s[-1] - taxels_s[0]) / 100)
    shift = offset + rate * (file_s - middle)
    start, stop = max(taxels_s[0], (file_s + shift)[0]), min(taxels_s[-1], (file_s + shift)[-1])
    common = np.linspace(float(start), float(stop), 2000)
    return JoinedClock(
        name, offset + apart, sigma, rate, middle + zeros[1], True, column, correlation,
        lags_s=lags[near] + apart, correlations=np.abs(found[near]), time_s=common + zeros[0],
        traces=np.stack([relative(np.interp(common, taxels_s, activity)),
                         relative(np.interp(common, file_s + shift, values))]),
    )  # fmt: skip


def common_step(*times_s: FloatArray) -> float:
    """Return the step of an even grid for times [s] of some files, each ascending."""
    longest = max(float(times[-1] - times[0]) for times in times_s)
    return max(min(usual_step(times) for times in times_s), longest / MOST_SAMPLES, 1e-6)


def relative(values: Any) -> FloatArray:
    """Return values (n,) from 0 to 1."""
    return (values - values.min()) / max(float(np.ptp(values)), 1e-300)


def convolved(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return the full convolution (n + m - 1,) of two signals (n,) and (m,)."""
    from scipy.signal import fftconvolve  # takes a second to load, which no import without an estimate needs

    return np.asarray(fftconvolve(left, right), dtype=np.float64)


def _correlations(
    a_s: FloatArray, a: FloatArray, b_s: FloatArray, b: FloatArray, step: float
) -> tuple[FloatArray, FloatArray]:
    """Return offsets of the clock of ``b``, and the correlations of its overlap with ``a``; NaN for a short overlap."""
    x = np.interp(np.arange(a_s[0], a_s[-1] + step / 2, step), a_s, a)
    y = np.interp(np.arange(b_s[0], b_s[-1] + step / 2, step), b_s, b)
    x, y = (x - x.mean()) / (x.std() or 1.0), (y - y.mean()) / (y.std() or 1.0)
    flipped = y[::-1]
    ones_x, ones_y = np.ones(len(x)), np.ones(len(y))
    count = np.maximum(np.rint(convolved(ones_x, ones_y)), 1.0)
    sum_x, sum_y = convolved(x, ones_y), convolved(ones_x, flipped)
    var_x = convolved(x**2, ones_y) - sum_x**2 / count
    var_y = convolved(ones_x, flipped**2) - sum_y**2 / count
    low = 1e-3 * count
    good = (count >= LEAST_OVERLAP * min(len(x), len(y))) & (var_x > low) & (var_y > low)
    top = convolved(x, flipped) - sum_x * sum_y / count
    found = np.divide(
        top, np.sqrt(np.maximum(var_x * var_y, 1e-300)), out=np.full(len(top), np.nan), where=good
    )
    lags = (np.arange(len(top)) - (len(y) - 1)) * step + a_s[0] - b_s[0]
    return lags, found


def best_lag(lags: FloatArray, found: FloatArray) -> int:
    """Return the index of the largest correlation; raise a NoOffsetError if one outside its peak is nearly as good."""
    at, filled = int(np.nanargmax(found)), np.nan_to_num(found)
    first, last = stretch_about(filled > filled[at] / 2, at)
    others = filled.copy()
    others[max(first - 1, 0) : last + 2] = 0.0
    second = int(others.argmax())
    if 1 - others[second] ** 2 < ALIKE * (1 - filled[at] ** 2) + 1e-9:
        raise NoOffsetError(
            f"offsets of {lags[at]:.4g} s and {lags[second]:.4g} s are equally good (correlations {filled[at]:.3f} and "
            f"{others[second]:.3f}): the presses are too similar; within_s narrows the search"
        )
    return at


def stretch_about(mask: BoolArray, at: int) -> tuple[int, int]:
    """Return the first and the last index of the stretch about ``at`` in which a mask holds."""
    others = np.flatnonzero(~mask)
    first = int(others[others < at].max(initial=-1)) + 1
    return first, int(others[others > at].min(initial=len(mask))) - 1


def _refined(
    a_s: FloatArray, a: FloatArray, b_s: FloatArray, b: FloatArray, start: float, reach: float
) -> tuple[float, float]:
    """Return the offset within ``reach`` of a start with the largest correlation, and that correlation."""
    from scipy.optimize import minimize_scalar

    def lost(offset: float) -> float:
        inside = (a_s >= b_s[0] + offset) & (a_s <= b_s[-1] + offset)
        x, y = a[inside], np.interp(a_s[inside] - offset, b_s, b)
        x, y = x - x.mean(), y - y.mean()
        return -float(x @ y) / float(np.sqrt((x @ x) * (y @ y)) or 1.0)

    found = minimize_scalar(
        lost, bounds=(start - reach, start + reach), method="bounded", options={"xatol": 1e-5}
    )
    return float(found.x), -float(found.fun)


def _parts(
    a_s: FloatArray, a: FloatArray, b_s: FloatArray, b: FloatArray, offset: float, step: float
) -> tuple[float, float, float, float]:
    """Return the offset's standard deviation, the rate, its middle and the offset there, by parts of the recording."""
    start, stop = max(a_s[0], b_s[0] + offset), min(a_s[-1], b_s[-1] + offset)
    edges = np.linspace(float(start), float(stop), PARTS + 1).tolist()
    reach = max(6 * step, 3 * usual_step(b_s), 0.5)
    total = float(np.var(a))
    found: list[tuple[float, float]] = []
    for low, high in pairwise(edges):
        inside = (a_s >= low) & (a_s < high)
        # A part in which hardly anything happens is not informative.
        if inside.sum() < 8 or float(np.var(a[inside])) < 0.1 * total:
            continue
        part, correlation = _refined(a_s[inside], a[inside], b_s, b, offset, reach)
        if correlation > LEAST_CORRELATION and abs(part - offset) < 0.95 * reach:
            found.append(((low + high) / 2 - offset, part))
    times, offsets = np.array(found).reshape(-1, 2).T
    middle, floor = float(times.mean()) if found else 0.0, step / np.sqrt(12 * max(len(found), 1))
    if len(found) < 3:
        return max(usual_step(b_s), step), 0.0, middle, offset
    times = times - middle
    if len(found) >= 5:
        (rate, mean), covariance = np.polyfit(times, offsets, 1, cov=True)
        span = float(np.ptp(times))
        if abs(rate) > SIGMAS * np.sqrt(covariance[0, 0]) and abs(rate) * span > usual_step(b_s) / 2:
            return max(float(np.sqrt(covariance[1, 1])), floor), float(rate), middle, float(mean)
    return max(robust_sigma(offsets) / np.sqrt(len(found)), floor), 0.0, middle, offset
