"""Latency and cost of the guard's stop: `python benchmarks/hand_stop.py [--repeats 50] [--json]`.

A simulated hand misbehaves in one of several ways; measured is the time from the call that goes wrong to the call of
the driver's `stop`.
"""

from __future__ import annotations

# ruff: noqa: D102 - methods of the driver interface
import argparse
import json
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from skincal.hand import (
    GuardedHand,
    GuardOptions,
    HandCommand,
    HandDriver,
    HandError,
    HandState,
    create_driver,
)
from skincal.robot import joint_contact_force

GOOD_PERIODS = 5
OPTIONS = GuardOptions(timeout_s=0.5, stale_s=0.2)


class Failing(HandDriver):
    """A hand that does as another one, until it is asked to fail."""

    name = "failing"

    def __init__(self, hand: HandDriver, fault: Callable[[HandState], HandState]) -> None:
        self._hand, self._fault = hand, fault
        self.real_time = hand.real_time
        self.observed, self.failed_at, self.stopped_at = 0, 0.0, 0.0

    description = property(lambda self: self._hand.description)
    period_s = property(lambda self: self._hand.period_s)

    def connect(self) -> None:
        self._hand.connect()

    def observe(self) -> HandState:
        self.observed += 1
        state = self._hand.observe()
        if self.observed <= GOOD_PERIODS:
            return state
        self.failed_at = self.failed_at or time.perf_counter()
        return self._fault(state)

    def act(self, command: HandCommand) -> None:
        self._hand.act(command)

    def stop(self) -> None:
        self.stopped_at = self.stopped_at or time.perf_counter()
        self._hand.stop()

    def close(self) -> None:
        self._hand.close()


def raising(state: HandState) -> HandState:
    raise RuntimeError("the bus is gone")


def hanging(state: HandState) -> HandState:
    time.sleep(OPTIONS.timeout_s + 0.2)
    return state


def interrupted(state: HandState) -> HandState:
    """Ctrl-C while the program waits for the hand."""
    main = threading.main_thread().ident
    assert main is not None
    signal.pthread_kill(main, signal.SIGINT)
    time.sleep(0.1)
    return state


class Stale:
    """The same state again and again."""

    def __init__(self) -> None:
        self._first: HandState | None = None

    def __call__(self, state: HandState) -> HandState:
        self._first = self._first or state
        time.sleep(0.005)
        return self._first


FAULTS: dict[str, Callable[[], Callable[[HandState], HandState]]] = {
    "raises": lambda: raising,
    "NaN": lambda: lambda s: replace(s, q_rad=np.full_like(s.q_rad, np.nan)),
    "wrong shape": lambda: lambda s: replace(s, taxels=np.zeros(3)),
    "clock goes back": lambda: lambda s: replace(s, time_s=s.time_s - 1.0),
    "stale taxels": lambda: lambda s: replace(s, taxel_time_s=s.taxel_time_s - 1.0),
    "force above the limit": lambda: lambda s: replace(s, tau_nm=np.full(6, 1.4)),
    "torque above the limit": lambda: lambda s: replace(s, tau_nm=np.full(6, 1.6)),
    "stale states": Stale,
    "hangs": lambda: hanging,
    "Ctrl-C": lambda: interrupted,
}


def stop_times_ms(
    fault: Callable[[], Callable[[HandState], HandState]], repeats: int
) -> tuple[list[float], str]:
    """From the bad call to `stop` [ms], for each repeat; and the kind of the error."""
    times, kind = [], ""
    for seed in range(repeats):
        driver = Failing(create_driver("sim", seed=seed), fault())
        try:
            with GuardedHand(driver, OPTIONS, joint_contact_force(driver.description)) as hand:
                for _ in range(1000):
                    hand.act(HandCommand(hand.observe().q_desired_rad))
        except HandError as error:
            kind = error.kind
        except KeyboardInterrupt:
            kind = "interrupt"
        assert kind, "the fault was not seen"
        times.append(1e3 * (driver.stopped_at - driver.failed_at))
    return times, kind


def cost_us(cycles: int = 2000) -> float:
    """Measure the guard's cost for a call to the simulated hand [us]."""

    def run(hand: HandDriver | GuardedHand) -> float:
        with hand:
            start = time.perf_counter()
            for _ in range(cycles):
                hand.act(HandCommand(hand.observe().q_desired_rad))
            return time.perf_counter() - start

    bare = min(run(create_driver("sim", seed=1)) for _ in range(3))
    guarded = min(run(GuardedHand(create_driver("sim", seed=1))) for _ in range(3))
    return 1e6 * (guarded - bare) / (2 * cycles)


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=50)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    found: dict[str, Any] = {}
    for name, fault in FAULTS.items():
        times, kind = stop_times_ms(fault, arguments.repeats if name not in ("hangs", "stale states") else 10)
        found[name] = {
            "kind": kind,
            "median_ms": float(np.median(times)),
            "max_ms": max(times),
            "runs": len(times),
        }
        if not arguments.json:
            print(
                f"{name:24s}{kind:12s}{np.median(times):8.2f} ms median{max(times):8.2f} ms at most, {len(times)} runs"
            )
    cost = cost_us()
    if arguments.json:
        print(json.dumps({"stop": found, "guard_us_per_call": cost}))
    else:
        print(f"the guard costs {cost:.0f} us a call")


if __name__ == "__main__":
    main()
