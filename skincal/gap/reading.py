"""What a session read, against what a model says of it: residuals in standard deviations, and what they weigh."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skincal.fit.observe import Readout, clipped_share, expected_counts
from skincal.gap.noise import rounding
from skincal.gap.session import GapSession
from skincal.model.arrays import BoolArray, FloatArray, as_floats

_LEAST_SHARE = 0.2
"""A value far beyond a bound scatters no less than this part of the noise: what is known of it is not certain."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Means of noisy, rounded and clipped frames.

    Attributes:
        counts: (N, J) what was read, NaN where nothing was.
        frames: (N,) frames that each row is the mean of, as far as its noise is concerned.
        sigma_counts: noise of one frame, before rounding and clipping.
        readout: the converter.
        trust: (N, J) one where a value counts, less where it is not believed.
        further: (N, J) variance that is not the taxels' own: of the measured force of each frame [counts²].
    """

    counts: FloatArray
    frames: FloatArray
    sigma_counts: float
    readout: Readout
    trust: FloatArray
    further: FloatArray

    @classmethod
    def of(cls, session: GapSession, sigma_counts: float, readout: Readout) -> Reading:
        """All that a session read.

        Raises:
            ValueError: a session that was only planned.
        """
        if session.counts is None:
            raise ValueError("reading: expected a session that was recorded; got a plan")
        trust = np.isfinite(session.counts).astype(np.float64)
        return cls(session.counts, session.frames, sigma_counts, readout, trust, np.zeros_like(trust))

    @property
    def seen(self) -> BoolArray:
        """(N, J) where something was read that is believed."""
        return self.trust > 0

    def with_counts(self, counts: FloatArray) -> Reading:
        """The same with other counts (N, J); where nothing was read, nothing is."""
        return replace(self, counts=np.where(np.isfinite(self.counts), counts, np.nan))

    def trusting(self, trust: FloatArray) -> Reading:
        """The same with less trust (N, J) in some values."""
        return replace(self, trust=self.trust * trust)

    def with_further(self, variance: FloatArray) -> Reading:
        """The same with variance (N, J) of a mean that is not the taxels' own [counts²]."""
        return replace(self, further=variance)

    def deviation(self, values: FloatArray) -> FloatArray:
        """Standard deviation (N, J) of a mean of frames at values (N, J) before the converter [counts]."""
        knots, share = self._shares
        full = float(np.hypot(self.sigma_counts, rounding(self.readout)))
        own = full * np.interp(values, knots, share) / np.sqrt(self.frames)[:, None]
        return np.hypot(own, np.sqrt(self.further))

    def expected(self, values: FloatArray) -> FloatArray:
        """Mean counts (N, J) at values (N, J) before the converter: clipping lifts an untouched taxel."""
        return as_floats(expected_counts(values, self.sigma_counts, self.readout))

    def residual(self, values: FloatArray) -> FloatArray:
        """(N, J) in standard deviations; zero where nothing was read."""
        gone = np.nan_to_num(self.counts) - self.expected(values)
        return np.where(self.seen, gone / self.deviation(values) * np.sqrt(self.trust), 0.0)

    def weight(self, values: FloatArray) -> FloatArray:
        """(N, J) by how many standard deviations the reading moves for one count of the value [1/counts]."""
        step = 0.05 * self.sigma_counts
        slope = (self.expected(values + step) - self.expected(values - step)) / (2 * step)
        return np.where(
            self.seen, np.clip(slope, 0.0, 1.0) / self.deviation(values) * np.sqrt(self.trust), 0.0
        )

    @cached_property
    def _shares(self) -> tuple[FloatArray, FloatArray]:
        """What clipping leaves of the noise, at values about the bounds."""
        bounds = [b for b in (self.readout.value_min, self.readout.value_max) if b is not None]
        if not bounds:
            return np.zeros(1), np.ones(1)
        near = np.linspace(-6.0, 6.0, 61) * self.sigma_counts
        knots = np.unique(np.concatenate([b + near for b in bounds]))
        share = [clipped_share(float(knot), self.sigma_counts, self.readout) for knot in knots]
        return knots, np.maximum(share, _LEAST_SHARE)
