"""Iterations that the contact solver of the environments needs.

    python -m benchmarks.solver_iterations [--episodes 20] [--seconds 2] [--json]

The same episodes with small random actions, the solver being allowed so many iterations; what differs from 1000.
Whether an object sticks or slips is decided by little, so that episodes drift apart in any case: the largest
difference of an episode, and of these the median and the 90th percentile.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

import skincal.envs
from skincal.envs.trajectories import POLICY_HZ

COUNTS = (5, 10, 20, 30, 50, 200)
MOST = 1000


def episodes(name: str, iterations: int, number: int, steps: int) -> tuple[list[np.ndarray], float]:
    """Places [m] and forces [N] of episodes, each (steps, 3), fewer if it is dropped; processor time of a step [s]."""
    env: Any = gymnasium.make(name, policy="desired", solver_iterations=iterations)
    found, begin = [], time.process_time()
    try:
        for seed in range(number):
            env.reset(seed=seed)
            rng, rows = np.random.default_rng(seed), []
            for _ in range(steps):
                _, _, ended, _, info = env.step(rng.uniform(-0.1, 0.1, env.action_space.shape))
                rows.append([*info["position_m"], info["force_n"]])
                if ended:
                    break
            found.append(np.array(rows))
    finally:
        env.close()
    return found, (time.process_time() - begin) / sum(map(len, found))


def apart(some: np.ndarray, others: np.ndarray) -> tuple[float, float]:
    """The largest difference between two runs of an episode: of places [m] and of forces [N]."""
    shared = min(len(some), len(others))
    difference = some[:shared] - others[:shared]
    return float(np.linalg.norm(difference[:, :2], axis=1).max()), float(np.abs(difference[:, 2]).max())


def measure(number: int, steps: int) -> dict[str, Any]:
    """For each environment and number of iterations."""
    table: dict[str, Any] = {}
    for name in skincal.envs.ENVIRONMENTS:
        exact, _ = episodes(name, MOST, number, steps)
        for iterations in COUNTS:
            found, step_s = episodes(name, iterations, number, steps)
            places, forces = np.array([apart(a, b) for a, b in zip(found, exact, strict=True)]).T
            table[f"{name.removeprefix('skincal/')}, {iterations} iterations"] = {
                "processor_ms_per_step": 1e3 * step_s,
                "place_median_um": 1e6 * float(np.median(places)),
                "place_90_um": 1e6 * float(np.quantile(places, 0.9)),
                "force_median_n": float(np.median(forces)),
                "force_90_n": float(np.quantile(forces, 0.9)),
            }
    return {"episodes": number, "seconds": steps / POLICY_HZ, "compared_with": MOST, "iterations": table}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measures; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.solver_iterations",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--episodes", type=int, default=20, help="of each (default 20)")
    parser.add_argument("--seconds", type=float, default=2.0, help="length of an episode (default 2)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    given = parser.parse_args(arguments)
    found = measure(given.episodes, round(given.seconds * POLICY_HZ))
    if given.json:
        print(json.dumps(found, indent=2))
    else:
        for name, row in found["iterations"].items():
            print(name, {key: float(f"{value:.3g}") for key, value in row.items()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
