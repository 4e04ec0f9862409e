"""What a session read, against what a model says of it: residuals in standard deviations, and what they weigh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skincal.fit.observe import Readout, clipped_share, expected_counts
from skincal.gap.noise import rounding
from skincal.inference.session import GapSession
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats

_LEAST_SHARE = 0.2
"""A value far beyond a bound scatters no less than this part of the noise: what is known of it is not certain."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Means of noisy, rounded and clipped frames.

    Attributes:
        counts: (N, J) what was read, NaN where nothing was.
        frames: (N,) frames that each row is the mean of, as far as its noise is concerned.
        sigma_counts: (J,) noise of one frame of each taxel, before rounding and clipping.
        readout: the converter.
        trust: (N, J) one where a value counts, less where it is not believed.
        further: (N, J) variance beside the noise of frames: of the measured force, in a chamber of what a taxel does
            alone, too [counts²].
        lift: (N, J) what jumps of the level at rest add before the converter [counts].
    """

    counts: FloatArray
    frames: FloatArray
    sigma_counts: FloatArray
    readout: Readout
    trust: FloatArray
    further: FloatArray
    lift: FloatArray

    @classmethod
    def of(cls, session: GapSession, sigma_counts: float | FloatArray, readout: Readout) -> Reading:
        """All that a session read.

        Args:
            session: that was recorded.
            sigma_counts: noise of one frame, one for all taxels or (J,).
            readout: the converter.

        Raises:
            ValueError: a session that was only planned.
        """
        if session.counts is None:
            raise ValueError("reading: expected a session that was recorded; got a plan")
        trust = np.isfinite(session.counts).astype(np.float64)
        sigma = as_floats(np.broadcast_to(sigma_counts, trust.shape[1:]))
        nothing = np.zeros_like(trust)
        return cls(session.counts, session.frames, sigma, readout, trust, nothing, nothing)

    @property
    def seen(self) -> BoolArray:
        """(N, J) where something was read that is believed."""
        return self.trust > 0

    @property
    def unlifted(self) -> FloatArray:
        """(N, J) counts less what jumps have added: what they would have been, but for clipping."""
        return self.counts - self.lift

    def with_counts(self, counts: FloatArray) -> Reading:
        """The same with other counts (N, J); where nothing was read, nothing is."""
        return replace(self, counts=np.where(np.isfinite(self.counts), counts, np.nan))

    def trusting(self, trust: FloatArray) -> Reading:
        """The same with less trust (N, J) in some values."""
        return replace(self, trust=self.trust * trust)

    def with_further(self, variance: FloatArray) -> Reading:
        """The same with variance (N, J) of a mean beside the noise of its frames [counts²]."""
        return replace(self, further=variance)

    def lifted(self, counts: FloatArray) -> Reading:
        """The same with levels at rest that are higher by so much (N, J), beside what lifts them already [counts].

        Lifting what is expected, rather than taking jumps off what was read, leaves to the converter what is its own:
        nobody can say of a mean what clipping would have made of its frames had they been lower.
        """
        return replace(self, lift=self.lift + counts)

    def deviation(self, values: FloatArray) -> FloatArray:
        """Standard deviation (N, J) of a mean of frames at values (N, J) before the converter [counts]."""
        full = np.hypot(self.sigma_counts, rounding(self.readout))
        own = full * self._by_noise(self._share, values + self.lift) / np.sqrt(self.frames)[:, None]
        return np.hypot(own, np.sqrt(self.further))

    def expected(self, values: FloatArray) -> FloatArray:
        """Mean counts (N, J) at values (N, J) before the converter: clipping lifts an untouched taxel."""
        return self._shown(values + self.lift)

    def expected_in(self, row: int, values: FloatArray) -> FloatArray:
        """The same (n, J) of one observation, at any values (n, J)."""
        return self._shown(values + self.lift[row])

    def _shown(self, values: FloatArray) -> FloatArray:
        return self._by_noise(
            lambda some, sigma: as_floats(expected_counts(some, sigma, self.readout)), values
        )

    def expected_of(self, taxel: int, values: FloatArray) -> FloatArray:
        """The same (n,) of one taxel at values (n,) that hold what lifts them already."""
        return as_floats(expected_counts(values, float(self.sigma_counts[taxel]), self.readout))

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

    def _by_noise(self, of: Callable[[FloatArray, float], FloatArray], values: FloatArray) -> FloatArray:
        """A function of values (N, J) and of the noise of their taxels: once for all that have the same noise."""
        if len(self._alike) == 1:
            return as_floats(of(values, self._alike[0][0]))
        found = np.empty_like(values)
        for sigma, taxels in self._alike:
            found[:, taxels] = of(values[:, taxels], sigma)
        return found

    @cached_property
    def _alike(self) -> list[tuple[float, IntArray]]:
        """Each noise that there is, and the taxels that have it."""
        return [
            (float(sigma), np.flatnonzero(self.sigma_counts == sigma))
            for sigma in np.unique(self.sigma_counts)
        ]

    def _share(self, values: FloatArray, sigma: float) -> FloatArray:
        """What clipping leaves of the noise, at values of any shape."""
        knots, share = self._shares[sigma]
        return as_floats(np.interp(values, knots, share))

    @cached_property
    def _shares(self) -> dict[float, tuple[FloatArray, FloatArray]]:
        """What clipping leaves of each noise, at values about the bounds."""
        return {sigma: self._shares_of(sigma) for sigma, _ in self._alike}

    def _shares_of(self, sigma: float) -> tuple[FloatArray, FloatArray]:
        bounds = [b for b in (self.readout.value_min, self.readout.value_max) if b is not None]
        if not bounds:
            return np.zeros(1), np.ones(1)
        near = np.linspace(-6.0, 6.0, 61) * sigma
        knots = np.unique(np.concatenate([b + near for b in bounds]))
        share = [clipped_share(float(knot), sigma, self.readout) for knot in knots]
        return knots, np.maximum(share, _LEAST_SHARE)
