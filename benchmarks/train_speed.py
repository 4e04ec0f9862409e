"""Time of a training run.

    python benchmarks/train_speed.py [--rounds 3] [--backends sb3 sbx] [--processes] [--json]

Rounds of a marble run with the published settings (8 environments, 480 environment steps, then 200 gradient steps), on
one core: processor time of a step of an environment, with all that the learner does for it, and of a gradient step; and
what a run of 800 000 steps comes to. With ``--processes`` also the time on the clock of rounds whose environments have
processes of their own, beside that of environments which take turns in one.
"""

# ruff: noqa: E402 - the number of threads is read when numpy is imported
from __future__ import annotations

import os

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[_threads] = "1"
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from skincal.train import BackendName, PolicyKind, Settings, Task, Work, maker, parallel
from skincal.train.settings import rounds_of
from skincal.train.training_run import _learner

FULL_STEPS = 800_000
SETTINGS = replace(Settings(), learning_starts=400)


def work(backend: str, policy: str) -> Work:
    return Work(Task.marble, PolicyKind(policy), 1, FULL_STEPS, BackendName(backend), SETTINGS)


def measure(backend: str, policy: str, rounds: int, clock: Callable[[], float]) -> dict[str, float]:
    """Times of an environment step and of a gradient step [s]; what is compiled or drawn at first is left out."""
    times: list[tuple[float, float]] = []
    with _learner(work(backend, policy), maker(work(backend, policy), None), processes=False) as learner:
        original = learner.model.train

        def train(**arguments: Any) -> None:
            began = clock()
            original(**arguments)
            learned.append(clock() - began)

        learner.model.train = train  # type: ignore[method-assign]
        for i in range(rounds + 2):
            learned: list[float] = []
            began = clock()
            learner.learn(1, i, lambda _: None)
            times.append((clock() - began - sum(learned), sum(learned)))
    gather, learn = (sum(column) / rounds for column in zip(*times[2:], strict=True))
    return {
        "environment_step_s": gather / SETTINGS.steps_per_round,
        "gradient_step_s": learn / SETTINGS.gradient_steps,
        "run_of_800000_steps_h": rounds_of(SETTINGS, FULL_STEPS) * (gather + learn) / 3600,
    }


def gathering(processes: bool, rounds: int) -> float:
    """Steps of an environment per second on the clock, random actions."""
    environments = parallel(maker(work("sb3", "tactile"), None), SETTINGS.environments, processes=processes)
    try:
        environments.seed(1)
        environments.reset()
        steps = rounds * SETTINGS.train_every
        began = time.perf_counter()
        for _ in range(steps):
            actions = [environments.action_space.sample() for _ in range(SETTINGS.environments)]
            environments.step(actions)  # type: ignore[arg-type]
        return steps * SETTINGS.environments / (time.perf_counter() - began)
    finally:
        environments.close()


def run(backends: list[str], rounds: int, *, processes: bool) -> dict[str, Any]:
    found: dict[str, Any] = {
        "processor_time": {
            f"{backend}, {policy}": measure(backend, policy, rounds, time.process_time)
            for backend in backends
            for policy in ("tactile", "desired")
        }
    }
    if processes:
        found["steps_per_s_on_the_clock"] = {
            "cores": len(os.sched_getaffinity(0)),
            "one process": gathering(False, rounds),
            "a process each": gathering(True, rounds),
        }
    return found


def show(result: dict[str, Any]) -> None:
    for name, part in result["processor_time"].items():
        step, gradient = 1e3 * part["environment_step_s"], 1e3 * part["gradient_step_s"]
        print(
            f"{name:16} {step:6.2f} ms a step, {gradient:6.2f} ms a gradient step, "
            f"{part['run_of_800000_steps_h']:.1f} h for {FULL_STEPS} steps"
        )
    for name, value in result.get("steps_per_s_on_the_clock", {}).items():
        print(f"{name:16} {value:6.0f}")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--backends", nargs="+", default=["sb3", "sbx"])
    parser.add_argument("--processes", action="store_true")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    arguments = parser.parse_args()
    result = run(arguments.backends, arguments.rounds, processes=arguments.processes)
    if arguments.json:
        print(json.dumps(result, indent=2))
    else:
        show(result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
