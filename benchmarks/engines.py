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
from skincal.envs.scene import ENGINES
from skincal.train import Task, bundled_policies, read_policy
from skincal.train.evaluate import Trial, environment_for, evaluate
from skincal.train.fare import settled_m

assert skincal.envs  # registers the tasks
RESULTS = Path(__file__).parent / "results" / "engines.json"
REST, MOVE = 10, 20
"""Steps at rest, and of commands, at 10 Hz."""


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
        point = env._sensor.patch_m(seen.tip.inside(np.array(seen.skin.point_m)))
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


def trial(name: str, engine: str, episodes: int) -> dict[str, Any]:
    policy = read_policy(bundled_policies()[name])
    asked = Trial(Task(str(policy.description.task)), episodes=episodes, seed=1)
    environment = environment_for(policy, asked, engine=engine)
    begin = time.process_time()
    runs = evaluate(policy, environment, asked)
    environment.close()
    late = runs.error_m[:, 20:]
    return {
        "episodes": episodes,
        "drops": int(runs.dropped.sum()),
        "error_m": float(np.nanmean(late)) if np.isfinite(late).any() else None,
        "by_run_m": [None if not np.isfinite(v) else float(v) for v in settled_m(runs)],
        "held_s": float(np.isfinite(runs.error_m).sum(axis=1).mean() / 10),
        "processor_s": (time.process_time() - begin) / episodes,
    }


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
        episodes = asked.bolt if name.startswith("bolt") else asked.marble
        for engine in ENGINES:
            one = once(f"{name} {engine} {episodes}", trial, name, engine, episodes)
            error = float("nan") if one["error_m"] is None else 1e3 * one["error_m"]
            print(
                f"{name} {engine}: {one['drops']} drops of {episodes}, error {error:.2f} mm, "
                f"held {one['held_s']:.1f} s, {one['processor_s']:.2f} s a run",
                flush=True,
            )


if __name__ == "__main__":
    main()
