"""What keeps the estimator of the marble's position from being better: its errors over ranges with parts made known.

    python -m benchmarks.estimator_limits [--hands 500] [--seed 0] [--json]

Each row trains an estimator as ``skincal train estimator`` does, over other ranges, with a marble of 6 mm radius.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict

from skincal.envs.pinch import read_pinch
from skincal.ranges import Parameter, Ranges, preset
from skincal.train.estimator_run import HANDS, train_estimator

RADIUS_M = 0.006
NOISE = ("skin.noise_sigma_counts", "skin.taxel_noise_counts")
SENSOR = ("skin.elasticity_pa_per_m", "skin.scale_per_n", "skin.taxel_offset_counts")


def known(ranges: Ranges, *names: str) -> Ranges:
    """Return ranges in which some parameters have the middle of theirs; noise is none, and so are offsets."""
    none = {*NOISE, "skin.taxel_offset_counts"}
    return ranges.replace({n: Parameter.constant(0.0 if n in none else ranges[n].middle()) for n in names})


def cases() -> dict[str, Ranges]:
    """Return the ranges of each row, by its name."""
    of = {
        name: preset(name).replace({"object.marble.radius_m": Parameter.constant(RADIUS_M)})
        for name in ("iros24", "icra26")
    }
    return {
        "ranges iros24": of["iros24"],
        "without noise": known(of["iros24"], *NOISE),
        "without noise; elasticity, scale and offsets known": known(of["iros24"], *NOISE, *SENSOR),
        "ranges icra26": of["icra26"],
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Measures; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.estimator_limits",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--hands", type=int, default=HANDS // 2, help="of each row (default 500)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="print JSON")
    given = parser.parse_args(arguments)
    found = {
        name: asdict(train_estimator(ranges, read_pinch(), seed=given.seed, hands=given.hands).quality)
        for name, ranges in cases().items()
    }
    if given.json:
        print(json.dumps(found, indent=2))
    else:
        for name, quality in found.items():
            print(f"{1e3 * quality['median_m']:.2f} mm  {name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
