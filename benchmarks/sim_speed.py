"""Speed of the simulated hand, and precision of its contact estimates from joints.

    python benchmarks/sim_speed.py [--presses 6] [--seeds 20] [--json]

A hand presses its skin again and again, as in a session: approach, hold, release, observed at 100 Hz, images at 25 Hz.
Processor time of one core, in parts: physics and drives alone, images, and the force and place that a program finds
from the joints. Over several seeds, in the hold, what the joints tell of the contact is compared with what is true.
"""

# ruff: noqa: E402 - the number of threads is read when numpy is imported
from __future__ import annotations

import os

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[_threads] = "1"

import argparse
import json
import sys
import time
from typing import Any

import numpy as np

from skincal.hand import HandCommand, HandState
from skincal.hand.sim import SimDriver
from skincal.model import Cylinder
from skincal.robot import Kinematics, contact_from_joints, place_indenter
from skincal.sim import SimOptions, TrueContact

HALF_M = 0.006


class Loop:
    """A hand that is moved between places of its skin, without any control of the force."""

    def __init__(self, driver: SimDriver, *, joints: bool) -> None:
        self.driver = driver
        self.kinematics = Kinematics(driver.description)
        self.joints = joints
        self.states = 0
        self.q = driver.description.home_rad

    def place(self, beta_rad: float, y_m: float, depth_m: float) -> np.ndarray:
        """Angles at which the sphere would stand so deep in the skin, if it did not resist."""
        reach = 0.0175 - depth_m
        target = [reach * np.sin(beta_rad), y_m, reach * np.cos(beta_rad)]
        return place_indenter(self.kinematics, target, self.driver.description.home_rad)

    def move(self, q_rad: np.ndarray, states: int) -> list[tuple[HandState, TrueContact]]:
        """Moves evenly, and returns what was seen; what is true is looked up for the last quarter only."""
        seen = []
        for i in range(states):
            state = self.driver.observe()
            self.driver.act(HandCommand(self.q + (q_rad - self.q) * (i + 1) / states))
            if self.joints:
                contact_from_joints(self.kinematics, state.q_rad, state.tau_nm)
            if i >= 3 * states // 4:
                seen.append((state, self.driver.simulated.contact()))
        self.q = q_rad
        self.states += states
        return seen

    def press(self, rng: np.random.Generator) -> list[tuple[HandState, TrueContact]]:
        """A press at a place and of a depth drawn; returns the end of the hold."""
        beta, y = rng.uniform(-HALF_M, HALF_M) / 0.0115, 0.0235 + rng.uniform(-HALF_M, HALF_M)
        self.move(self.place(beta, y, -0.003), 60)
        deep = self.place(beta, y, rng.uniform(0.002, 0.012))
        self.move(deep, 50)
        seen = self.move(deep, 100)
        self.move(self.place(beta, y, -0.003), 50)
        return seen


def speed(presses: int, *, joints: bool, taxel_hz: int = 25) -> dict[str, float]:
    with SimDriver(seed=1, options=SimOptions(taxel_hz=taxel_hz)) as driver:
        loop, rng = Loop(driver, joints=joints), np.random.default_rng(2)
        loop.press(rng)
        loop.states, begin = 0, time.process_time()
        for _ in range(presses):
            loop.press(rng)
        used, simulated = time.process_time() - begin, loop.states * driver.period_s
    return {"processor_s_per_simulated_s": used / simulated, "times_real_time": simulated / used}


def errors(seeds: int, presses: int) -> dict[str, Any]:
    """Joints less truth, means over holds: force [N], and place across and along [m]."""
    rows = []
    for seed in range(seeds):
        with SimDriver(seed=seed) as driver:
            loop, rng = Loop(driver, joints=False), np.random.default_rng(seed)
            rows += [(seed, *_error(loop, loop.press(rng))) for _ in range(presses)]
    table = np.array(rows)
    table = table[table[:, 1] > 0.3]
    relative = (table[:, 2] - table[:, 1]) / table[:, 1]
    place = table[:, 3:5]
    mean = np.array([place[table[:, 0] == s].mean(axis=0) for s in table[:, 0]])
    return {
        "holds": len(table),
        "position_error_rms_m": float(np.sqrt((place**2).sum(axis=1).mean())),
        "quantiles": {
            "true_force_n": quantiles(table[:, 1]),
            "force_error_n": quantiles(table[:, 2] - table[:, 1]),
            "force_error_relative": quantiles(relative),
            "position_error_m": quantiles(np.linalg.norm(place, axis=1)),
            "position_error_less_mean_m": quantiles(np.linalg.norm(place - mean, axis=1)),
        },
    }


def _error(loop: Loop, seen: list[tuple[HandState, TrueContact]]) -> tuple[float, float, float, float]:
    """True force, force by the joints, and their places' difference."""
    q, tau = (np.array([getattr(s, name) for s, _ in seen]) for name in ("q_rad", "tau_nm"))
    found = contact_from_joints(loop.kinematics, q.mean(axis=0), tau.mean(axis=0))
    point = np.mean([c.point_m for _, c in seen], axis=0)
    beta = Cylinder._beta(np.stack([found.points_m[0], point]))
    across = 0.0115 * (beta[0] - beta[1])
    force = float(np.mean([c.force_n for _, c in seen]))
    return force, float(found.force_n[0]), float(across), float(found.points_m[0, 1] - point[1])


def quantiles(values: np.ndarray) -> dict[str, float]:
    return {f"{q:g}": float(np.quantile(values, q)) for q in (0.05, 0.25, 0.5, 0.75, 0.95)}


def run(presses: int, seeds: int) -> dict[str, Any]:
    parts = {
        "fingers and drives": speed(presses, joints=False, taxel_hz=1),
        "fingers, drives, images": speed(presses, joints=False),
        "fingers, drives, images, contact from joints": speed(presses, joints=True),
    }
    return {**errors(seeds, presses), "processor_time": parts}


def show(result: dict[str, Any]) -> None:
    print("Processor time for a second of the simulated hand (and how many times faster than real time)")
    for name, part in result["processor_time"].items():
        print(
            f"  {name:46}{1e3 * part['processor_s_per_simulated_s']:7.1f} ms ({part['times_real_time']:.0f} x)"
        )
    print(f"\nJoints less truth in {result['holds']} holds: quantiles 0.05, 0.25, 0.5, 0.75, 0.95")
    for name, found in result["quantiles"].items():
        unit, scale = ("mm", 1e3) if name.endswith("_m") else ("%", 100) if "relative" in name else ("N", 1)
        print(f"  {name:30}{''.join(f'{scale * v:9.3f}' for v in found.values())} {unit}")
    print(f"  rms of the position error: {1e3 * result['position_error_rms_m']:.2f} mm")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--presses", type=int, default=6, help="presses of each seed")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    arguments = parser.parse_args()
    result = run(arguments.presses, arguments.seeds)
    if arguments.json:
        print(json.dumps(result, indent=2))
    else:
        show(result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
