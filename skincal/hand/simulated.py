"""What the drivers of simulated hands share: a rate that fits the physics, a stop from any thread, a file of truth."""

from __future__ import annotations

import json
import threading
from abc import abstractmethod
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from skincal.errors import input_error
from skincal.files import whole_file
from skincal.hand.driver import HandDriver


class SimulatedDriver(HandDriver):
    """A simulated hand; one that has been stopped holds its motors until it is connected again.

    Args:
        rate_hz: rate of states and commands [Hz].
        physics_hz: rate of the physics [Hz].

    Raises:
        InputError: the rate does not fit the physics.
    """

    def __init__(self, rate_hz: int, physics_hz: int) -> None:
        if not 0 < rate_hz <= physics_hz or physics_hz % rate_hz:
            expected = f"a divisor of the physics' {physics_hz} Hz"
            raise input_error(f'driver "{self.name}", option rate_hz', expected, rate_hz)
        self._steps, self._physics_hz = physics_hz // rate_hz, physics_hz
        self._moving, self._halted = threading.Lock(), threading.Event()

    @property
    def period_s(self) -> float:
        """Time between two states [s]."""
        return self._steps / self._physics_hz

    @abstractmethod
    def _hold(self) -> None:
        """Hold the motors where they are, which releases the forces; do nothing without a connection."""

    @contextmanager
    def _simulating(self) -> Generator[None]:
        """Keep :meth:`stop` out while physics runs, after the hold that an earlier one asked for."""
        with self._moving:
            if self._halted.is_set():
                self._hold()
            yield

    def stop(self) -> None:
        """Hold the motors where they are, which releases the forces."""
        self._halted.set()
        # While physics runs, the next period begins with the hold.
        if self._moving.acquire(blocking=False):
            try:
                self._hold()
            finally:
                self._moving.release()


def write_truth(path: Path, kind: str, truth: Mapping[str, Any]) -> None:
    """Write what is hidden from a fit, plain numbers, lists and texts, as a JSON file of some format."""
    with whole_file(path, force=True, mark=kind) as file:
        file.write_text(json.dumps({"format": kind, **truth}, indent=2) + "\n", encoding="utf-8")
