"""How well policies let go of pellets one at a time: ``python -m benchmarks.pellets POLICY … [--episodes 100]``.

Everything is drawn from the published ranges. An episode succeeds where never fewer are held than are asked for, and
one is left in the end. `none` in the place of a file is a hand that never moves.
"""

from __future__ import annotations

import argparse
from typing import Any

import gymnasium
import numpy as np
from scipy.stats import binomtest

import skincal.envs
from skincal.tasks import ENVIRONMENT_IDS
from skincal.train import Task, read_policy
from skincal.train.evaluate import check_fits, check_task

assert skincal.envs  # registers the tasks


def runs(file: str, episodes: int, seed: int, engine: str) -> list[dict[str, Any]]:
    """Episodes of a policy, in numbers."""
    policy = None if file == "none" else read_policy(file)
    kind = "desired" if policy is None else str(policy.description.policy)
    env: Any = gymnasium.make(ENVIRONMENT_IDS[Task.pellets], policy=kind, engine=engine)
    if policy is not None:
        check_task(policy, Task.pellets)
        check_fits(policy, env)
    found: list[dict[str, Any]] = []
    for number in range(episodes):
        observation, info = env.reset(
            seed=int(np.random.SeedSequence([seed, number]).generate_state(1)[0] >> 1)
        )
        right, over, lost, steps, begun = 0, False, False, 0, info["pellets_held"]
        while not over:
            action = np.zeros(env.action_space.shape) if policy is None else policy(observation["policy"])
            observation, _, lost, late, info = env.step(action)
            over, steps = lost or late, steps + 1
            right += info["pellets_held"] == info["pellets_target"]
        found.append({"pellets": begun, "success": info["success"], "right": right / 60, "lost": lost})
    env.close()
    return found


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("policies", nargs="+")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--engine", default="pybullet")
    asked = parser.parse_args()
    print(
        "| policy | one by one to the last | time with the right number | too many lost |\n|---|---|---|---|"
    )
    for file in asked.policies:
        found = runs(file, asked.episodes, asked.seed, asked.engine)
        good, count = sum(one["success"] for one in found), len(found)
        interval = binomtest(good, count).proportion_ci(0.95, method="wilson")
        print(
            f"| `{file}` | {good} of {count} ({interval.low:.0%} to {interval.high:.0%}) | "
            f"{np.mean([one['right'] for one in found]):.0%} | {sum(one['lost'] for one in found)} of {count} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
