"""Runs of the shipped policies on reference hands with hidden truths: ``python -m benchmarks.deploy_runs``.

Every finished run is kept in a file beside the results, so that an interrupted benchmark goes on.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from skincal.deploy import deploy, letters, marble_targets
from skincal.deploy.estimate import estimate_error_m, estimate_positions
from skincal.envs.pinch import read_pinch
from skincal.envs.reference_hand import ReferenceHand
from skincal.errors import SkincalError
from skincal.train import policy_path, read_policy
from skincal.train.estimator import read_estimator
from skincal.train.policy_file import estimator_path

RESULTS = Path(__file__).parent / "results" / "deploy_runs.json"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="hidden hands for each policy and way")
    runs = parser.parse_args().runs
    kept: dict[str, dict[str, float | bool | str]] = (
        json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    )
    pinch, estimator = read_pinch(None), read_estimator(estimator_path("marble-estimator-1"))
    ways = {"circle": marble_targets("circle", 8.0), "DLR": letters("DLR")}
    for name in ("marble-tactile-1", "marble-tactile-2"):
        policy = read_policy(policy_path(name))
        for way, targets in ways.items():
            for seed in range(runs):
                key = f"{name} {way} {seed}"
                if key in kept:
                    continue
                try:
                    found = deploy(
                        policy, ReferenceHand(seed=seed), pinch, targets,
                        object_width_m=0.012, speed_rad_per_s=0.3,
                    )  # fmt: skip
                    places = estimate_positions(found.record, estimator, pinch, 0.012)
                    kept[key] = {
                        "held": found.lost_s is None,
                        "error_m": float(np.nanmean(found.error_m[20:])),
                        "estimate_error_m": estimate_error_m(found.record, places) or float("nan"),
                    }
                except SkincalError as error:
                    nothing = {"error_m": float("nan"), "estimate_error_m": float("nan")}
                    kept[key] = {"held": False, **nothing, "stopped": str(error)}
                RESULTS.write_text(json.dumps(kept, indent=0) + "\n", encoding="utf-8")
            some = [kept[f"{name} {way} {seed}"] for seed in range(runs)]
            errors = np.array([one["error_m"] for one in some], dtype=float)
            off = 1e3 * np.array([one["estimate_error_m"] for one in some], dtype=float)
            low, high = np.nanpercentile(errors, [5, 95])
            held = sum(bool(one["held"]) for one in some)
            print(
                f"{name} {way}: held {held} of {runs}, error {1e3 * np.nanmean(errors):.2f} mm "
                f"({1e3 * low:.2f} to {1e3 * high:.2f}), way estimated to {np.nanmedian(off):.2f} mm "
                f"({np.nanmin(off):.2f} to {np.nanmax(off):.2f})",
                flush=True,
            )


if __name__ == "__main__":
    main()
