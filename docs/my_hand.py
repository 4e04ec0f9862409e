"""A driver for one's own hand: copy this file, and put your own hand in the place of `Device`.

    skincal hand test my_hand:MyHand
    skincal collect --driver my_hand:MyHand --out run

The driver moves values between the hand and skincal's types, and nothing else. It keeps no limits and waits for
nobody: skincal's guard does that, in front of it.
"""

# ruff: noqa: D102 - methods of the driver interface, documented there
from __future__ import annotations

import time
from threading import Lock
from typing import Annotated

import numpy as np

from skincal.hand import HandCommand, HandDriver, HandError, HandState
from skincal.robot import HandDescription, hand_named


class MyHand(HandDriver):
    """My hand, on its port.

    The keyword parameters are the driver's options: `--driver-option port=/dev/ttyUSB1`. Their annotations say how
    the text is read, and the text beside the type is their help in `skincal hand list`.
    """

    name = "my-hand"

    def __init__(
        self,
        *,
        port: Annotated[str, "where the hand is plugged in"] = "/dev/ttyUSB0",
        hand: Annotated[str, "its description: a name, or a hand.toml"] = "dlr_hand_2",
        rate_hz: Annotated[float, "states per second"] = 100.0,
    ) -> None:
        # Nothing is opened here: a driver is made before it is connected, and sometimes never is.
        self._description = hand_named(hand)
        self._port, self._rate_hz = port, rate_hz
        self._device: Device | None = None
        self._q_desired = self._description.home_rad

    @property
    def description(self) -> HandDescription:
        return self._description

    @property
    def period_s(self) -> float:
        return 1.0 / self._rate_hz

    def connect(self) -> None:
        if self._device is not None:
            return
        device = Device(self._port, self._rate_hz, self._description.home_rad)
        # Hold what is there: a hand that jumps to some home of its own when it is connected is dangerous.
        self._q_desired = device.angles()
        device.hold(self._q_desired)
        self._device = device

    def observe(self) -> HandState:
        device = self._connected("observe")
        time_s, q, dq, tau = device.wait_for_joints()
        counts, read_at_s = device.taxels()
        return HandState(
            time_s=time_s,
            # Arrays of this state alone: one that the next state overwrites would falsify the record.
            q_rad=q,
            dq_rad_per_s=dq,
            tau_nm=tau,
            q_desired_rad=self._q_desired.copy(),
            taxels=counts.astype(float),
            # When each taxel was read, on the clock of time_s - not when its value arrived here.
            taxel_time_s=np.full(len(counts), read_at_s),
        )

    def act(self, command: HandCommand) -> None:
        device = self._connected("act")
        self._q_desired = command.q_desired_rad.copy()
        device.hold(self._q_desired)

    def stop(self) -> None:
        # May come from another thread, at any time, twice, and before connect().
        device = self._device
        if device is not None:
            device.let_go()

    def close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.shut()

    def _connected(self, what: str) -> Device:
        if self._device is None:
            raise HandError(f"{what}() of a hand that is not connected", "order")
        return self._device


class Device:
    """Stands for the library that came with your hand: joints that follow, and a skin that nothing touches."""

    def __init__(self, port: str, rate_hz: float, q: np.ndarray) -> None:
        self._period_s = 1.0 / rate_hz
        self._lock = Lock()  # let_go() comes from another thread
        self._q, self._goal, self._stopped = q.copy(), q.copy(), False
        self._start_s = self._next_s = time.monotonic()

    def angles(self) -> np.ndarray:
        return self._q.copy()

    def hold(self, goal: np.ndarray) -> None:
        with self._lock:
            if not self._stopped:
                self._goal = goal.copy()

    def wait_for_joints(self) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        self._next_s = max(self._next_s + self._period_s, time.monotonic())
        time.sleep(max(0.0, self._next_s - time.monotonic()))
        with self._lock:
            before, self._q = self._q, self._q + 0.5 * (self._goal - self._q)
            dq = (self._q - before) / self._period_s
            return self._next_s - self._start_s, self._q.copy(), dq, np.zeros_like(dq)

    def taxels(self) -> tuple[np.ndarray, float]:
        return np.full(16, 3, dtype=np.uint8), self._next_s - self._start_s

    def let_go(self) -> None:
        with self._lock:
            self._goal, self._stopped = self._q.copy(), True

    def shut(self) -> None:
        self.let_go()
