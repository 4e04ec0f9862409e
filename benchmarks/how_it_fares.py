"""Predicted against found: ``python -m benchmarks.how_it_fares CAL [--hands 12] [--draws 60]``.

A policy is let act in simulation on hands drawn from a calibration, as `skincal eval --calibration` does, and from that
it is predicted how it will fare on one hand. Then it runs on reference hands whose truth is drawn from the same
calibration and hidden, through their driver and the guard. So this judges what lies between the tasks and a hand (the
taking of the object, the low-pass, a rate of 100 Hz), not whether the calibration itself holds its truth.
What is finished is kept beside the results, so that an interrupted benchmark goes on.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from skincal.calibration import read_calibration
from skincal.deploy.trials import reference_runs
from skincal.ranges import from_calibration
from skincal.train import Task, policy_path, read_policy
from skincal.train.evaluate import Trial, environment_for, evaluate
from skincal.train.scores import fare, settled_m

RESULTS = Path(__file__).parent / "results" / "how_it_fares.json"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("calibration", type=Path)
    parser.add_argument("--hands", type=int, default=12, help="hidden hands")
    parser.add_argument("--draws", type=int, default=60, help="hands drawn for the prediction")
    parser.add_argument("--policy", default="marble-tactile-1")
    asked = parser.parse_args()
    calibration = read_calibration(asked.calibration)
    ranges = from_calibration(calibration, joint=calibration.draws is not None)
    policy = read_policy(policy_path(asked.policy))
    kept: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}

    def keep(key: str, value: Any) -> Any:
        kept[key] = value
        RESULTS.write_text(json.dumps(kept, indent=0) + "\n", encoding="utf-8")
        return value

    key = f"{asked.policy} predicted {asked.draws}"
    if key not in kept:
        trial = Trial(Task.marble, episodes=asked.draws, seed=1, randomize=None)
        environment = environment_for(policy, trial, ranges)
        keep(key, asdict(fare(evaluate(policy, environment, trial))))
        environment.close()
    predicted = kept[key]
    found: list[dict[str, Any]] = []
    for hand in range(asked.hands):
        key = f"{asked.policy} found {hand}"
        if key not in kept:
            runs = reference_runs(policy, Trial(Task.marble, episodes=1, seed=5000 + hand), ranges=ranges)
            error = float(settled_m(runs)[0])
            keep(key, {"held": not runs.dropped[0], "error_m": error if np.isfinite(error) else None})
        found.append(kept[key])
    low, high = predicted["error_interval_m"]
    errors = [one["error_m"] for one in found if one["error_m"] is not None]
    inside = sum(low <= error <= high for error in errors)
    held = sum(bool(one["held"]) for one in found)
    share = binomtest(inside, len(errors)).proportion_ci(0.95, method="wilson") if errors else None
    print(
        f"predicted from {predicted['hands']} drawn hands: held {predicted['success']:.0%} "
        f"({predicted['success_interval'][0]:.0%} to {predicted['success_interval'][1]:.0%}), error on one hand "
        f"{1e3 * low:.2f} to {1e3 * high:.2f} mm ({predicted['level']:.0%})\n"
        f"found: held on {held} of {len(found)} hidden hands, error inside on {inside} of {len(errors)}"
        + (f" ({share.low:.0%} to {share.high:.0%}, Wilson)" if share else "")
        + f", median {1e3 * float(np.median(errors)):.2f} mm"
    )


if __name__ == "__main__":
    main()
