"""The same task in PyBullet and in MuJoCo: ``python -m benchmarks.engines [--presses 60] [--marble 100] [--bolt 20]``.

Press by press: grasps with everything drawn, 1 s at rest, then 2 s of the same slow commands in both engines; of each
the force on the skin, the contact point on it and the tactile image without noise. Run by run: the published evaluation
of the policies that come along. What is finished is kept beside the results, so that an interrupted benchmark goes on.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import skincal.envs
from skincal.tasks import Engine
from skincal.train import Task, bundled_policies, read_policy
from skincal.train.evaluate import Trial, environment_for, episode

assert skincal.envs  # registers the tasks
RESULTS = Path(__file__).parent / "results" / "engines.json"
REST, MOVE = 10, 20
"""Steps at rest, and of commands, at 10 Hz."""
SETTLED = 20
"""Steps of a run before its error counts."""


def press(engine: str, seed: int) -> dict[str, Any]:
    """A grasp, as it is at rest and after the commands."""
    env: Any = gymnasium.make("skincal/MarbleRoll-v0", disable_env_checker=True, engine=engine).unwrapped
    quiet = {
        "object.marble.random_force_n": 0.0,
        "finger.joint_noise_rad": 0.0,
        "skin.taxel_noise_counts": 0.0,
    }
    env.reset(seed=seed, options={"trajectory": "still", "values": quiet, "duration_s": 10.0})
    rng, found = np.random.default_rng(seed), {}
    slow = rng.uniform(-0.15, 0.15, env.action_space.shape)
    for name, action, steps in (("rest", np.zeros(6), REST), ("moved", slow, MOVE)):
        lost = False
        for _ in range(steps):
            lost = lost or env.step(action)[2]
        if lost:
            break
        seen = env.truth
        point = env.world.sensor.patch_m(seen.tip.inside(np.array(seen.skin.point_m)))
        found[name] = {"force_n": seen.skin.force_n, "point_m": point.tolist(), "image": env.image.tolist()}
    env.close()
    return found


def compare(pairs: list[tuple[dict[str, Any], dict[str, Any]]], name: str) -> str:
    """Medians and 95 % points of the differences at a moment, over the presses that both engines held."""
    both = [(a[name], b[name]) for a, b in pairs if name in a and name in b]
    force = np.array([[a["force_n"], b["force_n"]] for a, b in both])
    points = np.array([[a["point_m"], b["point_m"]] for a, b in both])
    images = np.array([[a["image"], b["image"]] for a, b in both])
    apart = {
        "force [%]": 100 * np.abs(force[:, 1] / force[:, 0] - 1),
        "contact point [mm]": 1e3 * np.linalg.norm(points[:, 1] - points[:, 0], axis=1),
        "image, RMS [counts]": np.sqrt(((images[:, 1] - images[:, 0]) ** 2).mean(axis=1)),
    }
    figures = ", ".join(
        f"{k}: {np.median(v):.2f} (95 %: {np.quantile(v, 0.95):.2f})" for k, v in apart.items()
    )
    largest = np.median(images[:, 0].max(axis=1))
    return f"{name}: {len(both)} of {len(pairs)} held in both; {figures}; largest taxel {largest:.0f} counts"


class Trials:
    """Runs of a policy in an engine, one by one."""

    def __init__(self, name: str, engine: str) -> None:
        self._policy = read_policy(bundled_policies()[name])
        self._trial = Trial(Task(str(self._policy.description.task)), seed=1)
        self._engine, self._made = engine, None

    def run(self, number: int) -> dict[str, Any]:
        """One run of the published evaluation."""
        self._made = self._made or environment_for(self._policy, self._trial, engine=self._engine)
        begin, errors, drop = time.process_time(), [], False
        for step in episode(self._policy, self._made, self._trial, number):
            drop = bool(step.info["drop"])
            if not drop:
                errors.append(float(step.info["error_m"]))
        late = errors[SETTLED:]
        return {
            "dropped": drop,
            "error_m": float(np.mean(late)) if late else None,
            "held_s": len(errors) / 10,
            "processor_s": time.process_time() - begin,
        }


def tell(name: str, engine: str, runs: list[dict[str, Any]]) -> str:
    """A row of the table."""
    errors = 1e3 * np.array([one["error_m"] for one in runs if one["error_m"] is not None])
    means = np.random.default_rng(0).choice(errors, (2000, len(errors))).mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    drops = sum(one["dropped"] for one in runs)
    # The first run compiles.
    cost = np.median([one["processor_s"] for one in runs])
    return (
        f"| `{name}` | {engine} | {drops} of {len(runs)} | {errors.mean():.2f} mm ({low:.2f} to {high:.2f}) | "
        f"{cost:.2f} s |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presses", type=int, default=60)
    parser.add_argument("--marble", type=int, default=100, help="runs of each of the marble's policies")
    parser.add_argument("--bolt", type=int, default=20, help="runs of each of the bolt's policies with touch")
    asked = parser.parse_args()
    kept: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}

    def once(key: str, make: Any, *arguments: Any) -> Any:
        if key not in kept:
            kept[key] = make(*arguments)
            RESULTS.write_text(json.dumps(kept, indent=0) + "\n", encoding="utf-8")
        return kept[key]

    pairs = [
        (once(f"press pybullet {n}", press, "pybullet", n), once(f"press mujoco {n}", press, "mujoco", n))
        for n in range(asked.presses)
    ]
    for name in ("rest", "moved"):
        print(compare(pairs, name), flush=True)
    for name in bundled_policies():
        if "tactile" not in name:
            continue
        count = asked.bolt if name.startswith("bolt") else asked.marble
        for engine in Engine:
            trials = Trials(name, engine)
            runs = [once(f"{name} {engine} run {k}", trials.run, k) for k in range(count)]
            print(tell(name, engine, runs), flush=True)


if __name__ == "__main__":
    main()
