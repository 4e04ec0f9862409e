"""A tiny hand, two joints and 2 x 2 taxels, that can be made to fail in any way."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from skincal.dataset import DatasetMeta, IndenterSpec, MountSpec, PositionSpec, SensorSpec, SurfaceSpec
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.robot.description import FingerDescription, HandDescription, ImpedanceGains, JointLimits

PERIOD_S = 0.01
JOINTS = ("thumb", "finger")


def tiny_description(urdf: Path = Path("/nowhere/tiny.urdf")) -> HandDescription:
    meta = DatasetMeta(
        sensor=SensorSpec(2, 2, (0.0025, 0.0025), (0.004, 0.004), value_min=0, value_max=255, integer=True),
        surface=SurfaceSpec("cylinder", 0.0115),
        indenter=IndenterSpec("sphere", 0.006),
        mount=MountSpec(
            0.0235, 0.0, (0.02, 0.027), (-20.0, 20.0), beta_deg=0.0, beta_range_deg=(-12.0, 12.0)
        ),
        position=PositionSpec(0.001, 0.002),
    )
    pair = np.ones(2)
    return HandDescription(
        name="tiny",
        urdf=urdf,
        joints=JOINTS,
        limits=JointLimits(-1.0 * pair, 1.0 * pair, 2.0 * pair, 1.5 * pair),
        gains=ImpedanceGains(5.0 * pair, 0.3 * pair, 5.0),
        skin_finger=FingerDescription("finger", ("finger",), "finger_tip"),
        indenter_finger=FingerDescription("thumb", ("thumb",), "thumb_tip"),
        home_rad=np.zeros(2),
        max_force_n=8.0,
        meta=meta,
        digest="00" * 32,
    )


class FakeHand(HandDriver):
    """A hand that follows commands at once; ``odd`` changes its states, ``hang`` its calls."""

    name = "fake"

    def __init__(
        self,
        odd: Callable[[HandState], Any] | None = None,
        *,
        raises: dict[str, BaseException] | None = None,
        hang: dict[str, float] | None = None,
        after: int = 3,
        pace_s: float = 0.0,
        real_time: bool = False,
    ) -> None:
        self.real_time = real_time
        self.odd = odd or (lambda state: state)
        self.raises = raises or {}
        self.hang = hang or {}
        self.after = after
        self.pace_s = pace_s
        self.calls: list[str] = []
        self.threads: dict[str, str] = {}
        self.commands: list[np.ndarray] = []
        self.stopped_at: float | None = None
        self.raised_at = 0.0
        self.q = np.zeros(2)
        self.ticks = 0
        self.connected = False

    @property
    def description(self) -> HandDescription:
        return tiny_description()

    @property
    def period_s(self) -> float:
        return PERIOD_S

    def _told(self, what: str) -> None:
        self.calls.append(what)
        self.threads[what] = threading.current_thread().name
        if self.ticks < self.after and what in ("observe", "act"):
            return
        if what in self.hang:
            time.sleep(self.hang[what])
        if what in self.raises:
            self.raised_at = time.monotonic()
            raise self.raises[what]

    def connect(self) -> None:
        self._told("connect")
        self.connected = True
        self.stopped_at = None

    def observe(self) -> HandState:
        self._told("observe")
        if not self.connected:
            raise RuntimeError("not connected")
        self.ticks += 1
        time.sleep(self.pace_s)
        t = self.ticks * PERIOD_S
        zeros = np.zeros(2)
        state = HandState(
            t, self.q.copy(), zeros, zeros.copy(), self.q.copy(), np.full(4, 7.0), np.full(4, t), 24.0
        )
        return self.odd(state) if self.ticks > self.after else state

    def act(self, command: HandCommand) -> None:
        self._told("act")
        self.commands.append(command.q_desired_rad.copy())
        if self.stopped_at is None:
            self.q = command.q_desired_rad.copy()

    def stop(self) -> None:
        if self.stopped_at is None:
            self.stopped_at = time.monotonic()
        self._told("stop")

    def close(self) -> None:
        self._told("close")
        self.connected = False


class Hands:
    """Makes fake hands for a server, and keeps them."""

    def __init__(self, make: Callable[[], FakeHand] = FakeHand) -> None:
        self._make = make
        self.made: list[FakeHand] = []

    def __call__(self) -> FakeHand:
        self.made.append(self._make())
        return self.made[-1]

    @property
    def last(self) -> FakeHand:
        return self.made[-1]


def changed(**values: Any) -> Callable[[HandState], HandState]:
    """A state with some values replaced; a value may be a function of the state."""

    def change(state: HandState) -> HandState:
        return replace(state, **{k: v(state) if callable(v) else v for k, v in values.items()})

    return change
