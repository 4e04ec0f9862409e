"""The control loop with the hand: one command and one sample per period."""

from __future__ import annotations

from collections.abc import Callable

from skincal.collect.senses import Sample, Senses
from skincal.hand.guard import GuardedHand
from skincal.model.arrays import FloatArray

Watcher = Callable[[Sample, str], None]
"""Callback with every sample and the present action of the hand."""


class Loop:
    """Control loop that commands the hand through its guard and stores the samples."""

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
        """Return the next sample, without sending a command."""
        sample = self.senses.sample(self.hand.observe())
        self.samples.append(sample)
        if self._watch is not None:
            self._watch(sample, self.doing)
        return sample

    def step(self, command_rad: FloatArray) -> Sample:
        """Send commanded angles (n,) [rad], limited to what the joints may do; return the next sample."""
        self.hand.act(self.hand.nearest(command_rad))
        return self.look()

    def hold(self, command_rad: FloatArray, time_s: float) -> list[Sample]:
        """Hold commanded angles for a time; return the samples."""
        return [self.step(command_rad) for _ in range(self.steps(time_s))]

    def steps(self, time_s: float) -> int:
        """Return the number of periods in a time, at least one."""
        return max(1, round(time_s / self.period_s))

    def take(self) -> list[Sample]:
        """Return the samples since the last call, and clear them."""
        taken, self.samples = self.samples, []
        return taken
