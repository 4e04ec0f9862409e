"""The observation model: what a taxel's count is expected to be for a signal, and how far it may be off.

    count = converter(signal + level at rest) + noise,    sd² = (sigma_n c)² + (tau a)²

One model for sensors whose level at rest is clipped and for those where it is not. ``c`` is what clipping leaves of the
noise, 1 away from the bounds. ``a`` is the signal that the taxel or, in part, a neighbour carries: what the model does
not know of contact and taxels grows with it, and does not show where nothing presses. Thresholds follow from the data,
so that values may be counts, volts or shares of full scale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from skincal.fitting.observe import Observed, Readout, clipped_share, expected_counts
from skincal.fitting.types import Bools, Floats
from skincal.model import TaxelLayout
from skincal.model.rest import rounding_step

NEIGHBOUR = 0.3
"""Part of a neighbour's signal by which a reading may be off as by its own: pressure that lies across an edge."""

_NEAR = 1.6
"""Taxels are neighbours up to so many smallest distances: the eight round a taxel of a grid."""

MODEL_PART = 1e-3
"""Part of a press's whole image up to which simulated images are exact: interpolation of the tabled load shares."""

_DARK = 4.0
_KNOTS = 400
_REACH = 8.0
"""Beyond so many sigmas from the bound clipping does not matter."""


@dataclass(frozen=True, eq=False)
class Link:
    """Mean count and scatter for values above a lower bound, tabled; without a bound the value itself.

    Attributes:
        values: (N,) equally spaced values above the bound; empty where nothing clips.
        mean: (N,) mean count above the bound.
        slope: (N,) its derivative.
        share: (N,) part of the noise that clipping leaves.
    """

    values: Floats
    mean: Floats
    slope: Floats
    share: Floats

    @classmethod
    def of(cls, readout: Readout, frame_sigma: float) -> Link:
        """The link of a converter.

        Args:
            readout: bounds and rounding.
            frame_sigma: noise of one frame [counts]; NaN where clipping does not show.
        """
        if not np.isfinite(frame_sigma) or readout.value_min is None:
            empty = np.empty(0)
            return cls(empty, empty, empty, empty)
        return cls(*_tabled(readout.integer, float(frame_sigma)))

    @property
    def clips(self) -> bool:
        """Return whether it is other than the identity."""
        return len(self.values) > 0

    def mean_at(self, values: Floats) -> Floats:
        """Mean counts (…) of values above the bound (…)."""
        if not self.clips:
            return values
        at = (values - self.values[0]) / (self.values[1] - self.values[0])
        at = np.clip(at, 0.0, len(self.values) - 1.001)
        low, lift = at.astype(np.intp), self.mean - self.values
        return values + lift[low] + (at - low) * (lift[low + 1] - lift[low])

    def scatter(self, values: Floats) -> Floats:
        """Part of the noise (…) that clipping leaves at values above the bound (…)."""
        return np.interp(values, self.values, self.share) if self.clips else np.ones_like(values)


@lru_cache(maxsize=16)
def _tabled(integer: bool, sigma: float) -> tuple[Floats, Floats, Floats, Floats]:
    readout = Readout(0.0, None, integer)
    values = np.linspace(-_REACH * sigma, _REACH * sigma + 1.0, _KNOTS)
    mean = expected_counts(values, sigma, readout)
    some = values[::8]
    share = np.interp(values, some, [clipped_share(float(v), sigma, readout) for v in some])
    return values, mean, np.gradient(mean, values), share


class Response(NamedTuple):
    """Response of a taxel to a signal: the counts above rest for signals x that a straight response would read.

    y = x c (1 + (x / s)^q)^(-k / q): a straight line up to the knee s, the power 1 - k beyond it. With k = 1 it
    saturates, with k < 0 it grows faster than the load.

    Attributes:
        lost: k, power that is lost beyond the knee; 0 for a straight line.
        knee_counts: s.
        sharpness: q, of the bend at the knee.
        factor: c.
    """

    lost: float = 0.0
    knee_counts: float = 1.0
    sharpness: float = 1.0
    factor: float = 1.0

    def of(self, signal: float) -> float:
        """Return the counts above rest for a signal [counts]; compiled: :func:`skincal.fitting.residuals.answered`."""
        beyond = (max(signal, 0.0) / self.knee_counts) ** self.sharpness
        return signal * self.factor * (1.0 + beyond) ** (-self.lost / self.sharpness)


STRAIGHT = Response()


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings, and the weight of each.

    Attributes:
        target: (K, J) counts above the lower bound, 0 where not read.
        read: (K, J) whether a taxel was read.
        offset: (J,) level at rest above the lower bound.
        link: from values above the bound to counts.
        share: (K, J) part of the noise that clipping leaves.
        signal: (K, J) size ``a`` that the error of the model grows with [counts].
        noise_counts: noise of a hold mean where nothing clips, as untouched taxels tell it.
        floor_counts: no reading is better known than this: rounding, and the exactness of simulated images.
        typical_counts: usual largest signal of a press.
        near: (J, J) which taxels lie next to each other.
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
        cls, seen: Observed, counts: Floats, readout: Readout, layout: TaxelLayout, rows: np.ndarray
    ) -> Readings:
        """The readings of some presses.

        Args:
            seen: what the counts of all presses became.
            counts: (K, J) counts of all presses.
            readout: of the converter.
            layout: the taxels.
            rows: of the presses that are used.
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
        """The size ``a`` (K, J) for the signals (K, J) of the taxels."""
        beside = np.stack([signal[:, row].max(axis=1, initial=0.0) for row in self.near], axis=1)
        return np.maximum(signal, NEIGHBOUR * beside)

    def at(self, signal: Floats) -> Readings:
        """The same with sizes and scatter as simulated signals (K, J) have them, not as noisy readings do."""
        return replace(self, signal=self.spread(signal), share=self.link.scatter(signal + self.offset))

    def subset(self, keep: Bools) -> Readings:
        """The readings of some presses (K,)."""
        return replace(
            self, **{name: getattr(self, name)[keep] for name in ("target", "read", "share", "signal")}
        )

    def parts(self, used: Bools) -> tuple[Floats, Floats]:
        """Return what sigma_n² and tau² are multiplied by in the variances of some readings (K, J): (n,) each."""
        return self.share[used] ** 2, self.signal[used] ** 2

    def variance(self, noise: Floats, misfit: Floats, press: np.ndarray) -> Floats:
        """Variance (n, J) of readings of presses (n,), for sigma_n (n,) [counts] and tau (n,)."""
        own = self.share[press] * noise[:, None]
        return own * own + (self.signal[press] * misfit[:, None]) ** 2


def _noise(seen: Observed, readout: Readout, typical: float) -> float:
    """Noise of a hold mean of a taxel away from the bounds [counts].

    Clipping takes four tenths off the scatter of a taxel at rest on its bound; that is undone. Where no taxel is ever
    untouched, one percent of the usual signal stands in.
    """
    scatter, frame = seen.rest_sigma_counts, seen.frame_sigma_counts
    if not np.isfinite(scatter):
        return 0.01 * typical
    if not np.isfinite(frame):
        return scatter
    return scatter / max(clipped_share(readout.value_min or 0.0, frame, readout), 0.2)
