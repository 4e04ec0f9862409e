"""The loop with the hand: a command each period, and a sample of what came of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from skincal.collect.samples import Sample, Senses
from skincal.hand.guard import GuardedHand

FloatArray = NDArray[np.float64]

Watcher = Callable[[Sample, str], None]
"""Is told every sample and what the hand is doing."""


class Loop:
    """Commands the hand through its guard, and keeps what is seen.

    Args:
        hand: connected.
        senses: turns states into samples.
        watch: is told every sample.
    """

    def __init__(self, hand: GuardedHand, senses: Senses, watch: Watcher | None = None) -> None:
        self.hand, self.senses = hand, senses
        self._watch = watch
        self.period_s = hand.period_s
        self.samples: list[Sample] = []
        self.doing = ""

    @property
    def now(self) -> Sample:
        """The last sample."""
        return self.samples[-1]

    def look(self) -> Sample:
        """Return the next sample, without a command."""
        sample = self.senses.sample(self.hand.observe())
        self.samples.append(sample)
        if self._watch is not None:
            self._watch(sample, self.doing)
        return sample

    def step(self, command_rad: FloatArray) -> Sample:
        """Send commanded angles (n,) [rad], cut to what the joints may do, and returns the next sample."""
        self.hand.act(self.hand.nearest(command_rad))
        return self.look()

    def hold(self, command_rad: FloatArray, time_s: float) -> list[Sample]:
        """Hold commanded angles for a time; returns its samples."""
        return [self.step(command_rad) for _ in range(self.steps(time_s))]

    def steps(self, time_s: float) -> int:
        """How many periods a time has, at least one."""
        return max(1, round(time_s / self.period_s))

    def take(self) -> list[Sample]:
        """Return the samples since the last time, which are not kept any longer."""
        taken, self.samples = self.samples, []
        return taken
