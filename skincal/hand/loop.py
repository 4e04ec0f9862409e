"""The loop that commands a hand through its guard, once in every period, and keeps what it observes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, TypeVar

from skincal.hand.driver import HandState
from skincal.hand.guard import GuardedHand
from skincal.model.arrays import FloatArray

Sample = TypeVar("Sample")


class ControlLoop(ABC, Generic[Sample]):
    """Control loop of a hand.

    Args:
        hand: the hand, connected.
        watch: callback with every sample and what the hand is doing.

    Attributes:
        samples: what was observed, in order.
        doing: what the hand is doing.
    """

    def __init__(self, hand: GuardedHand, watch: Callable[[Sample, str], None] | None = None) -> None:
        self.hand, self._watch = hand, watch
        self.period_s = hand.period_s
        self.samples: list[Sample] = []
        self.doing = ""

    @abstractmethod
    def _sample(self, state: HandState) -> Sample:
        """Return what is kept of a state."""

    @property
    def now(self) -> Sample:
        """The last sample."""
        return self.samples[-1]

    def look(self) -> Sample:
        """Return the next sample, without sending a command."""
        sample = self._sample(self.hand.observe())
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
