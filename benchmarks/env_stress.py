"""Do the environments stand anything? Random and extreme actions, a million steps if asked for.

    python benchmarks/env_stress.py [--steps 20000] [--seed 0] [--json]

Each episode takes one of several ways of acting, from small noise to jumps between the limits, everything randomized.
Looked at in each step: observations and rewards finite and within their spaces, the normal force, the angles of the
links against the joint limits. The exit status is 1 if anything is not finite or beyond physics: a joint at its torque
limit can press with some 20 N; impacts of the tips on each other or on the object may be several times harder.
"""

# ruff: noqa: E402 - the number of threads is read when numpy is imported
from __future__ import annotations

import os

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[_threads] = "1"

import argparse
import json
import sys
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

import skincal.envs

Act = Callable[[np.random.Generator, int], NDArray[np.float64]]
JOINTS = 6
LARGEST_N = 60.0
"""A normal force beyond this is no physics [N]."""

WAYS: dict[str, Act] = {
    "small noise": lambda rng, k: rng.uniform(-0.1, 0.1, JOINTS),
    "noise": lambda rng, k: rng.uniform(-1.0, 1.0, JOINTS),
    "limits": lambda rng, k: rng.choice([-1.0, 1.0], JOINTS),
    "all one way": lambda rng, k: np.ones(JOINTS) * (1.0 if k % 100 < 50 else -1.0),
    "squeezing": lambda rng, k: np.array([0.0, 1.0, 1.0, 0.0, 1.0, 1.0]) + rng.normal(0, 0.1, JOINTS),
    "beyond the limits": lambda rng, k: rng.normal(0.0, 1e6, JOINTS),
    "not finite": lambda rng, k: rng.choice([np.nan, np.inf, -np.inf, 0.1, -0.1], JOINTS),
}


def stress(name: str, policy: str, steps: int, seed: int, duration_s: float = 12.0) -> dict[str, Any]:
    """One task under all ways of acting, an episode each in turn."""
    env: Any = gymnasium.make(name, policy=policy, disable_env_checker=True)
    space, rng = env.observation_space, np.random.default_rng(seed)
    found = {"steps": 0, "episodes": 0, "drops": 0, "outside_the_space": 0, "not_finite": 0}
    force = past = 0.0
    limits = env.unwrapped.pinch.description.limits
    while found["steps"] < steps:
        act = list(WAYS.values())[found["episodes"] % len(WAYS)]
        observation, info = env.reset(seed=seed + found["episodes"], options={"duration_s": duration_s})
        found["episodes"] += 1
        ended, k = False, 0
        while not ended:
            observation, reward, terminated, truncated, info = env.step(act(rng, k))
            ended, k = terminated or truncated, k + 1
            found["outside_the_space"] += not space.contains(observation)
            found["not_finite"] += not (np.isfinite(reward) and np.isfinite(info["error_m"]))
            force = max(force, info["force_n"])
            q = env.unwrapped.truth.q_rad
            past = max(past, float(np.maximum(q - limits.upper_rad, limits.lower_rad - q).max()))
        found["steps"] += k
        found["drops"] += info["drop"]
    env.close()
    sound = not found["outside_the_space"] and not found["not_finite"] and force < LARGEST_N
    return {**found, "largest_force_n": force, "furthest_past_joint_limits_rad": past, "sound": sound}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=20000, help="steps of each task")
    parser.add_argument("--policy", choices=("tactile", "joint-angles", "desired"), default="tactile")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    arguments = parser.parse_args()
    result = {
        name: stress(name, arguments.policy, arguments.steps, arguments.seed)
        for name in skincal.envs.ENVIRONMENTS
    }
    if arguments.json:
        print(json.dumps(result, indent=2))
    else:
        for name, found in result.items():
            print(f"{name}: {', '.join(f'{key} {value}' for key, value in found.items())}")
    return 0 if all(found["sound"] for found in result.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
