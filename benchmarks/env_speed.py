"""Speed of the environments, and the cost of the skin.

    python benchmarks/env_speed.py [--steps 600] [--json]

One environment with tactile images of 0.25 mm resolution: processor time of one core, resets included, while small
random actions move the object. The engine's share is PyBullet's calls in the steps of physics, also those of the grasp
at the beginning. The skin's share is all that is not there without it: its patch in each episode, the contact in its
frame, the image with offsets, noise and converter. Then several environments side by side, in one process and in a
process each: steps a second by the wall clock, so the machine should have nothing else to do.
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
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

import skincal.envs
from skincal.envs.trajectories import POLICY_HZ

PAPER_REAL_TIME = 1.8
"""Times real time of the paper's simulation, one core of an AMD EPYC 7B13."""
NUMBERS = (1, 2, 8)


class Watch:
    """Sums up the processor time that some methods of objects take."""

    def __init__(self) -> None:
        self.used_s = 0.0

    def on(self, thing: Any, name: str) -> None:
        """Times a method from now on."""
        method = getattr(thing, name)

        def timed(*args: Any, **kwargs: Any) -> Any:
            begin = time.process_time()
            try:
                return method(*args, **kwargs)
            finally:
                self.used_s += time.process_time() - begin

        setattr(thing, name, timed)


def roll(env: Any, steps: int) -> int:
    """Moves on by at least so many steps in whole episodes; returns how many."""
    rng, done, seed = np.random.default_rng(0), 0, 0
    while done < steps:
        env.reset(seed=seed)
        seed, ended = seed + 1, False
        while not ended:
            _, _, terminated, truncated, _ = env.step(rng.uniform(-0.15, 0.15, env.action_space.shape))
            done, ended = done + 1, terminated or truncated
    return done


def engine_part(env: Any, steps: int = 400) -> float:
    """Part of the time of steps of physics that is PyBullet's calls.

    A piece of an episode again and again, in turn with its drives and with their torques known: a machine whose speed
    varies is as fast for the one as for the other.
    """
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, np.float32))
    scene = env.unwrapped.world.scene
    engine, drive, torques = scene.engine, scene.drives.step, []
    begun, state = engine.saveState(), scene.drives._state.copy()

    def recorded(q: Any, dq: Any) -> Any:
        torques.append(drive(q, dq))
        return torques[-1]

    scene.drives.step = recorded
    scene.run(steps)
    used: dict[bool, list[float]] = {False: [], True: []}
    for known in [False, True] * 9:
        engine.restoreState(begun)
        scene.drives._state[:] = state
        given = iter(torques)
        scene.drives.step = (lambda q, dq: next(given)) if known else drive  # noqa: B023
        begin = time.process_time()
        scene.run(steps)
        used[known].append(time.process_time() - begin)
    return float(np.median(used[True]) / np.median(used[False]))


def one(name: str, policy: str, steps: int) -> dict[str, float]:
    """Processor time of one environment."""
    env: Any = gymnasium.make(name, policy=policy)
    roll(env, 60)
    watch, physics = Watch(), Watch()
    physics.on(env.unwrapped.world.scene, "run")
    if policy == "tactile":
        for method in ("begin", "image"):
            watch.on(env.unwrapped.skin, method)
        watch.on(env.unwrapped, "skin_contact")
    begin = time.process_time()
    done = roll(env, steps)
    used = time.process_time() - begin
    engine_share = physics.used_s / used * engine_part(env)
    env.close()
    return {
        "processor_ms_per_step": 1e3 * used / done,
        "times_real_time": done / POLICY_HZ / used,
        "skin_share": watch.used_s / used,
        "engine_share": engine_share,
    }


def many(name: str, number: int, steps: int, *, processes: bool) -> float:
    """Steps a second of several tactile environments together, by the wall clock."""
    makers: list[Callable[[], Any]] = [partial(gymnasium.make, name)] * number
    envs: Any = AsyncVectorEnv(makers) if processes else SyncVectorEnv(makers)
    rng = np.random.default_rng(0)
    try:
        envs.reset(seed=0)
        rounds, begin = max(1, steps // number), time.perf_counter()
        for _ in range(rounds):
            envs.step(rng.uniform(-0.15, 0.15, envs.action_space.shape).astype(np.float32))
        return number * rounds / (time.perf_counter() - begin)
    finally:
        envs.close()


def run(steps: int) -> dict[str, Any]:
    single = {
        f"{name.removeprefix('skincal/')}, {policy}": one(name, policy, steps)
        for name in skincal.envs.ENVIRONMENTS
        for policy in ("tactile", "desired")
    }
    marble = next(iter(skincal.envs.ENVIRONMENTS))
    side_by_side = {
        f"{number} of {marble.removeprefix('skincal/')}": {
            "steps_per_second_in_one_process": many(marble, number, steps, processes=False),
            "steps_per_second_in_processes": many(marble, number, steps, processes=True),
        }
        for number in NUMBERS
    }
    return {
        "cores": os.cpu_count(),
        "paper_times_real_time": PAPER_REAL_TIME,
        "one_environment": single,
        "several_environments": side_by_side,
    }


def show(result: dict[str, Any]) -> None:
    print("One environment, processor time of one core")
    for name, found in result["one_environment"].items():
        print(
            f"  {name:26}{found['processor_ms_per_step']:7.2f} ms a step, {found['times_real_time']:5.1f} x real time,"
            f" skin {100 * found['skin_share']:.1f} %, engine {100 * found['engine_share']:.1f} %"
        )
    print(f"\nSeveral tactile environments on {result['cores']} cores, steps a second")
    for name, found in result["several_environments"].items():
        rates = [f"{value:7.0f} {key.removeprefix('steps_per_second_')}" for key, value in found.items()]
        print(f"  {name:26}{', '.join(rates).replace('_', ' ')}")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=600, help="steps of each measurement")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    arguments = parser.parse_args()
    result = run(arguments.steps)
    if arguments.json:
        print(json.dumps(result, indent=2))
    else:
        show(result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
