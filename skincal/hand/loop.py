"""The loop that commands a rig through its guard, once in every period, and keeps what it observes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from skincal.hand.guard_calls import Guarded
from skincal.model.arrays import FloatArray

Rig = TypeVar("Rig", bound=Guarded[Any, Any, Any])
Sample = TypeVar("Sample")


class ControlLoop(ABC, Generic[Rig, Sample]):
    """Control loop of a rig.

    Args:
        rig: the rig, connected.
        watch: callback with every sample and what the rig is doing.

    Attributes:
        samples: the samples of the observed states, in order.
        command: the last command.
        doing: what the rig is doing.
    """

    def __init__(self, rig: Rig, watch: Callable[[Sample, str], None] | None = None) -> None:
        self.rig, self._watch = rig, watch
        self.period_s = rig.period_s
        self.samples: list[Sample] = []
        self.command: Any = None
        self.doing = ""

    @abstractmethod
    def _sample(self, state: Any) -> Sample:
        """Return what is kept of a state."""

    @property
    def now(self) -> Sample:
        """The last sample."""
        return self.samples[-1]

    def look(self) -> Sample:
        """Return the next sample, without sending a command."""
        sample = self._sample(self.rig.observe())
        self.samples.append(sample)
        if self._watch is not None:
            self._watch(sample, self.doing)
        return sample

    def step(self, target: FloatArray) -> Sample:
        """Send the allowed command nearest to a target (n,); return the next sample."""
        self.command = self.rig.nearest(target)
        self.rig.act(self.command)
        return self.look()

    def hold(self, target: FloatArray, time_s: float) -> list[Sample]:
        """Send the same target for a time; return the samples."""
        return [self.step(target) for _ in range(self.steps(time_s))]

    def steps(self, time_s: float) -> int:
        """Return the number of periods in a time, at least one."""
        return max(1, round(time_s / self.period_s))

    def take(self) -> list[Sample]:
        """Return the samples since the last call, and clear them."""
        taken, self.samples = self.samples, []
        return taken
