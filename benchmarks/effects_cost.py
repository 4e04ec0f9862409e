"""What effects cost a policy that knows nothing of them: ``python -m benchmarks.effects_cost [--draws 4] [--runs 5]``.

For each of the effects some draws of its parameters at strength 1, and for each of them some runs on hands that are
drawn anew, everything randomized; each run once with the effect and once without, all else being the same. The table
gives the mean error from 2 s on, what the effect adds to it with a 95 % interval (bootstrapped over the pairs of
runs), and drops. What is finished is kept beside the results, so that an interrupted benchmark goes on.
"""

from __future__ import annotations

import argparse
import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from skincal.dataset.dataset import layout_of
from skincal.effects import EFFECTS
from skincal.envs.drawing import RIG_EFFECTS
from skincal.envs.pinch import read_pinch
from skincal.errors import SkincalError
from skincal.ranges import Parameter, Ranges, preset
from skincal.train import Task, policy_path, read_policy
from skincal.train.evaluate import Trial, environment_for, evaluate
from skincal.train.scores import settled_m

RESULTS = Path(__file__).parent / "results" / "effects_cost.json"


def with_effect(name: str, draw: int) -> Ranges:
    """The published ranges, and an effect whose parameters are drawn."""
    layout = layout_of(read_pinch(None).description.meta.sensor, None)
    rng = np.random.default_rng([zlib.crc32(name.encode()), draw])
    drawn = EFFECTS[name].at_strength(1.0, rng, layout)
    extra = {
        f"skin.effects.{name}.{key}": Parameter.constant(
            float(value) if np.ndim(value) == 0 else tuple(np.asarray(value, dtype=float).ravel().tolist())
        )
        for key, value in drawn.items()
    }
    return preset("iros24").replace(extra)


def runs_of(policy_name: str, engine: str, ranges: Ranges, draw: int, runs: int) -> dict[str, list[Any]]:
    policy = read_policy(policy_path(policy_name))
    trial = Trial(Task.marble, episodes=runs, seed=1000 + draw, randomize=None)
    environment = environment_for(policy, trial, ranges, engine=engine)
    found = evaluate(policy, environment, trial)
    environment.close()
    errors = [float(v) if np.isfinite(v) else None for v in settled_m(found)]
    return {"error_m": errors, "dropped": found.dropped.tolist()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=4, help="of each effect's parameters")
    parser.add_argument("--runs", type=int, default=5, help="with each of them")
    parser.add_argument("--policy", default="marble-tactile-1")
    parser.add_argument("--engine", default="pybullet", choices=("pybullet", "mujoco"))
    asked = parser.parse_args()
    kept: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}

    def once(name: str, draw: int) -> dict[str, Any]:
        key = f"{asked.policy} {asked.engine} {name} {draw} {asked.runs}"
        if key not in kept:
            try:
                ranges = preset("iros24") if name == "none" else with_effect(name, draw)
                kept[key] = runs_of(asked.policy, asked.engine, ranges, draw, asked.runs)
            except SkincalError as error:
                kept[key] = {"refused": str(error)}
            RESULTS.write_text(json.dumps(kept, indent=0) + "\n", encoding="utf-8")
        return kept[key]

    rng = np.random.default_rng(0)
    print("| effect | error without | added by it | drops without | with |\n|---|---|---|---|---|")
    for name in EFFECTS:
        if name in RIG_EFFECTS:
            print(f"| `{name}` | – | an error of the measuring rig, not of the skin | – | – |")
            continue
        pairs = [(once("none", draw), once(name, draw)) for draw in range(asked.draws)]
        # Pairs in which either run was over before 2 s have no error; drops count them.
        refused = [b["refused"] for _, b in pairs if "refused" in b]
        if refused:
            print(f"| `{name}` | – | {refused[0]} | – | – |")
            continue
        without, with_it = (np.array([pair[i]["error_m"] for pair in pairs], dtype=float) for i in (0, 1))
        added = (with_it - without).ravel()
        added = added[np.isfinite(added)]
        means = rng.choice(added, (2000, len(added))).mean(axis=1)
        low, high = 1e3 * np.quantile(means, [0.025, 0.975])
        drops = [sum(sum(pair[i]["dropped"]) for pair in pairs) for i in (0, 1)]
        total = asked.draws * asked.runs
        print(
            f"| `{name}` | {1e3 * np.nanmean(without):.2f} mm | {1e3 * added.mean():+.2f} mm "
            f"({low:+.2f} to {high:+.2f}) | {drops[0]} of {total} | {drops[1]} of {total} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
