"""The observation model: the expected count of a taxel for a signal, and its standard deviation.

    count = converter(signal + rest level) + noise,    sd² = (sigma_n c)² + (tau a)²

One model serves sensors whose rest level is clipped and sensors whose rest level is not. ``c`` is the
fraction of the noise that clipping leaves, 1 away from the bounds. ``a`` is the signal of the taxel, or a
fraction of that of a neighbour: the error of the model grows with it, and vanishes where nothing presses.
Thresholds follow from the data, so values may be counts, volts or fractions of full scale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from skincal.fitting.observe import ImagesAboveRest, Readout, clipped_share, expected_counts
from skincal.fitting.types import Bools, Floats
from skincal.model import TaxelLayout
from skincal.model.rest import rounding_step

NEIGHBOUR = 0.3
"""Fraction of a neighbour's signal that enters the size ``a``: pressure that lies across an edge."""

_NEAR = 1.6
"""Taxels up to this multiple of the smallest distance are neighbours: the eight around a taxel of a grid."""

MODEL_PART = 1e-3
"""Error of simulated images as a fraction of a press's whole image: interpolation of the tabled load shares."""

_DARK = 4.0
"""Readings below this multiple of the noise count as dark."""
_KNOTS = 400
"""Number of knots of the link table."""
_REACH = 8.0
"""Distance from the bound, in sigmas, beyond which clipping has no effect."""


@dataclass(frozen=True, eq=False)
class Link:
    """Table of mean count and scatter for values above a lower bound; the identity if there is no bound.

    Attributes:
        values: (N,) equally spaced values above the bound; empty if nothing clips.
        mean: (N,) mean count above the bound.
        slope: (N,) its derivative.
        share: (N,) fraction of the noise that clipping leaves.
    """

    values: Floats
    mean: Floats
    slope: Floats
    share: Floats

    @classmethod
    def of(cls, readout: Readout, frame_sigma: float) -> Link:
        """Return the link of a converter.

        Args:
            readout: bounds and rounding.
            frame_sigma: noise of one frame [counts]; NaN if clipping does not show.
        """
        if not np.isfinite(frame_sigma) or readout.value_min is None:
            empty = np.empty(0)
            return cls(empty, empty, empty, empty)
        return cls(*_tabled(readout.integer, float(frame_sigma)))

    @property
    def clips(self) -> bool:
        """Return whether the link is other than the identity."""
        return len(self.values) > 0

    def mean_at(self, values: Floats) -> Floats:
        """Return mean counts (…) of values above the bound (…)."""
        if not self.clips:
            return values
        at = (values - self.values[0]) / (self.values[1] - self.values[0])
        at = np.clip(at, 0.0, len(self.values) - 1.001)
        low, lift = at.astype(np.intp), self.mean - self.values
        return values + lift[low] + (at - low) * (lift[low + 1] - lift[low])

    def scatter(self, values: Floats) -> Floats:
        """Return the fraction of the noise (…) that clipping leaves at values above the bound (…)."""
        return np.interp(values, self.values, self.share) if self.clips else np.ones_like(values)


@lru_cache(maxsize=16)
def _tabled(integer: bool, sigma: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return values, mean, slope and noise fraction of a link with lower bound 0."""
    readout = Readout(0.0, None, integer)
    values = np.linspace(-_REACH * sigma, _REACH * sigma + 1.0, _KNOTS)
    mean = expected_counts(values, sigma, readout)
    some = values[::8]
    share = np.interp(values, some, [clipped_share(float(v), sigma, readout) for v in some])
    return values, mean, np.gradient(mean, values), share


class Response(NamedTuple):
    """Response of a taxel: counts above rest for a signal x, which a linear taxel would read unchanged.

    y = x c (1 + (x / s)^q)^(-k / q): linear up to the knee s, the power 1 - k beyond it. With k = 1 it
    saturates, with k < 0 it grows faster than the load.

    Attributes:
        lost: k, loss of power beyond the knee; 0 for a linear response.
        knee_counts: s.
        sharpness: q, of the bend at the knee.
        factor: c.
    """

    lost: float = 0.0
    knee_counts: float = 1.0
    sharpness: float = 1.0
    factor: float = 1.0

    def of(self, signal: float) -> float:
        """Return the counts above rest for a signal [counts]; the compiled twin is ``residuals.apply_response``."""
        beyond = (max(signal, 0.0) / self.knee_counts) ** self.sharpness
        return signal * self.factor * (1.0 + beyond) ** (-self.lost / self.sharpness)


STRAIGHT = Response()
"""The linear response."""


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings and their weights.

    Attributes:
        target: (K, J) counts above the lower bound, 0 where not read.
        read: (K, J) whether a taxel was read.
        offset: (J,) rest level above the lower bound.
        link: from values above the bound to counts.
        share: (K, J) fraction of the noise that clipping leaves.
        signal: (K, J) size ``a`` that the error of the model grows with [counts].
        noise_counts: noise of a hold mean where nothing clips, from untouched taxels.
        floor_counts: lower bound of the noise: rounding, and the error of simulated images.
        typical_counts: median over presses of the largest signal.
        near: (J, J) whether two taxels are neighbours.
        response: of the taxels to the load.
    """

    target: Floats
    read: Bools
    offset: Floats
    link: Link
    share: Floats
    signal: Floats
    noise_counts: float
    floor_counts: float
    typical_counts: float
    near: Bools
    response: Response = STRAIGHT

    @classmethod
    def of(
        cls, seen: ImagesAboveRest, counts: Floats, readout: Readout, layout: TaxelLayout, rows: np.ndarray
    ) -> Readings:
        """Return the readings of some presses.

        Args:
            seen: unclipped values of all presses.
            counts: (K, J) counts of all presses.
            readout: of the converter.
            layout: the taxels.
            rows: rows of the presses that are used.
        """
        values = seen.values[rows]
        read = np.isfinite(values)
        link = Link.of(readout, seen.frame_sigma_counts)
        offset = np.nan_to_num(seen.rest_counts)
        above = np.where(read, values, 0.0) + offset
        positive = np.where(read, np.maximum(values, 0.0), 0.0)
        typical = float(np.median(positive.max(axis=1))) if len(rows) else 0.0
        whole = float(np.median(positive.sum(axis=1))) if len(rows) else 0.0
        floor = max(
            rounding_step(counts[np.isfinite(counts)]) / np.sqrt(12.0),
            MODEL_PART * whole,
            np.finfo(float).tiny,
        )
        noise = _noise(seen, readout, typical)
        dark = np.where(values < _DARK * noise, offset, above)
        apart = layout.apart_m
        near = np.isfinite(apart) & (apart <= _NEAR * float(apart.min(initial=np.inf)))
        base = cls(
            link.mean_at(above),
            read,
            offset,
            link,
            link.scatter(dark),
            np.zeros_like(above),
            max(noise, floor),
            floor,
            typical,
            near,
        )
        return replace(base, signal=base.spread(np.where(values < _DARK * noise, 0.0, positive)))

    def spread(self, signal: Floats) -> Floats:
        """Return the size ``a`` (K, J) for signals (K, J): the own signal, or a fraction of the largest neighbour's."""
        neighbours = np.stack([signal[:, row].max(axis=1, initial=0.0) for row in self.near], axis=1)
        return np.maximum(signal, NEIGHBOUR * neighbours)

    def at(self, signal: Floats) -> Readings:
        """Return the readings with size and scatter from simulated signals (K, J), not from noisy readings."""
        return replace(self, signal=self.spread(signal), share=self.link.scatter(signal + self.offset))

    def subset(self, keep: Bools) -> Readings:
        """Return the readings of some presses (K,)."""
        return replace(
            self, **{name: getattr(self, name)[keep] for name in ("target", "read", "share", "signal")}
        )

    def parts(self, used: Bools) -> tuple[Floats, Floats]:
        """Return the coefficients (n,) of sigma_n² and of tau² in the variances of some readings (K, J)."""
        return self.share[used] ** 2, self.signal[used] ** 2

    def variance(self, noise: Floats, misfit: Floats, press: np.ndarray) -> Floats:
        """Return the variance (n, J) of readings of presses (n,), for sigma_n (n,) [counts] and tau (n,)."""
        own = self.share[press] * noise[:, None]
        return own * own + (self.signal[press] * misfit[:, None]) ** 2


def _noise(seen: ImagesAboveRest, readout: Readout, typical: float) -> float:
    """Return the noise of a hold mean of a taxel away from the bounds [counts].

    Clipping reduces the scatter of a taxel at rest on its bound by four tenths; this is undone. If no taxel
    is ever untouched, one percent of the typical signal stands in.
    """
    scatter, frame = seen.rest_sigma_counts, seen.frame_sigma_counts
    if not np.isfinite(scatter):
        return 0.01 * typical
    if not np.isfinite(frame):
        return scatter
    return scatter / max(clipped_share(readout.value_min or 0.0, frame, readout), 0.2)
