"""Driver of the simulated hand, with which every step can be tried without a hand; what all simulated hands share."""

from __future__ import annotations

import json
import threading
from abc import abstractmethod
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from skincal.calibration import read_calibration
from skincal.errors import input_error
from skincal.files import whole_file
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import HandError
from skincal.robot import hand_named
from skincal.robot.description import HandDescription
from skincal.sim import SimOptions, SimulatedHand, SkinMemory, Truth, TruthOptions
from skincal.sim.physics_client import check_engine


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


TRUTH_FORMAT = "skincal-sim-truth/1"
_TRUTH_STREAM, _NOISE_STREAM = 0, 1

LATEST_S = 1e6
"""Lead time of the hand's clock before the start [s]."""

BREAK_S = 1.0
"""Gap between the last remembered contact of a skin and the start of a resumed session [s]."""


class SimDriver(SimulatedDriver):
    """A simulated hand with a reference skin whose true parameters are drawn by the seed.

    Its clock runs as fast as the computer allows: a call of :meth:`observe` advances it by one period. The same seed,
    hand, effects and commands give the same states, bit for bit.

    Args:
        seed: seed of the truth and of all noise.
        effects: strength of each effect that the skin has beyond the base model, by name; 1 is a typical case.
        hand: name of a bundled hand, or the path of a ``hand.toml``.
        calibration: folder of a calibration of this hand's sensor, whose skin and effects are used. Without it pose,
            E and S are drawn.
        truth_path: file for the truth (JSON), written when the hand is connected, and again at the end of the session.
        rate_hz: rate of states and commands [Hz].
        start_s: start of the hand's clock [s], for a resumed session: its noise is new, and drifts continue.
        indenter_radius_m: radius of the sphere on the cap [m]; None: the hand's own. The description does not change.
        memory_path: file with the skin's contact history. If it exists, the skin remembers its contacts, and the
            clock continues after them.
        options: options of the physics.
        truth_options: ranges of the truth.

    Raises:
        InputError: the rate does not fit the physics, the sphere has no size, the hand or calibration cannot
            be read or do not fit each other, or an effect is unknown.
    """

    name = "sim"
    real_time = False

    def __init__(
        self,
        *,
        seed: Annotated[int, "seed of the hidden truth and of all noise"] = 0,
        effects: Annotated[Mapping[str, float] | None, "strengths of effects; 1 is a typical case"] = None,
        hand: Annotated[str, "name of the hand, or its hand.toml"] = "dlr_hand_2",
        calibration: Annotated[Path | None, "calibration whose skin the hand has"] = None,
        truth_path: Annotated[Path | None, "file for the truth (JSON)"] = None,
        rate_hz: Annotated[int, "states and commands per second"] = 100,
        start_s: Annotated[float, "start of the hand's clock [s]"] = 0.0,
        indenter_radius_m: Annotated[float | None, "radius of another sphere on the cap [m]"] = None,
        memory_path: Annotated[Path | None, "file with the contact history of a resumed session"] = None,
        options: SimOptions | None = None,
        truth_options: TruthOptions | None = None,
    ) -> None:
        check_engine()
        self._options = options or SimOptions()
        super().__init__(rate_hz, self._options.physics_hz)
        if not 0 <= start_s < LATEST_S:
            expected = f"a time from 0 to {LATEST_S:g} s"
            raise input_error('driver "sim", option start_s', expected, start_s)
        if indenter_radius_m is not None and not 0 < indenter_radius_m <= 1.0:
            expected, got = "a radius above 0 m, 1 m at most", str(indenter_radius_m)
            raise input_error('driver "sim", option indenter_radius_m', expected, got)
        self._seed, self._start_s = seed, start_s
        self._indenter_radius_m, self._memory_path = indenter_radius_m, memory_path
        self._description = hand_named(hand)
        self._truth_path = truth_path
        self.truth = Truth.draw(
            np.random.default_rng([seed, _TRUTH_STREAM]), self._description, truth_options, effects
        )
        if calibration is not None:
            self.truth = self.truth.with_skin(read_calibration(calibration), self._description)
        self._hand: SimulatedHand | None = None

    @property
    def description(self) -> HandDescription:
        """The hand."""
        return self._description

    @property
    def simulated(self) -> SimulatedHand:
        """The hand behind the driver, for tests and studies: it knows the true contact.

        Raises:
            HandError: not connected.
        """
        if self._hand is None:
            raise HandError('driver "sim": expected a hand that is connected; call connect() first', "order")
        return self._hand

    def connect(self) -> None:
        """Start a session: the hand stands at its home angles, at time 0 apart from a first image."""
        self._halted.clear()
        if self._hand is None:
            description = self._capped()
            path = self._memory_path
            memory = None if path is None else SkinMemory(path, len(description.joints))
            start_s = self._start_s if memory is None else max(self._start_s, memory.end_s + BREAK_S)
            later = [round(1e3 * start_s)] if start_s > 0 else []
            rng = np.random.default_rng([self._seed, _NOISE_STREAM, *later])
            self._hand = SimulatedHand(description, self.truth, rng, self._options, start_s, memory)
            self._write_truth(self._hand)

    def observe(self) -> HandState:
        """Advance the hand by one period and return its state."""
        hand = self.simulated
        with self._simulating():
            hand.advance(self._steps)
            return hand.reading()

    def act(self, command: HandCommand) -> None:
        """Set the target angles. A hand that has been stopped stays so until it is connected again."""
        if not self._halted.is_set():
            self.simulated.command(command.q_desired_rad)

    def _hold(self) -> None:
        if self._hand is not None:
            self._hand.hold()

    def close(self) -> None:
        """End the session; write the truth again, with the position errors of the session's contacts."""
        hand, self._hand = self._hand, None
        if hand is None:
            return
        self._write_truth(hand)
        hand.close()

    def _capped(self) -> HandDescription:
        hand, radius_m = self._description, self._indenter_radius_m
        if radius_m is None:
            return hand
        return replace(hand, meta=replace(hand.meta, indenter=replace(hand.meta.indenter, radius_m=radius_m)))

    def _write_truth(self, hand: SimulatedHand) -> None:
        if self._truth_path is not None:
            truth = {"seed": self._seed, "hand": self._description.name, **hand.truth_dict()}
            write_truth(self._truth_path, TRUTH_FORMAT, truth)
