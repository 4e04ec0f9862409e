"""Does ``skincal rescale`` find how much sensitivity a skin has lost? On reference hands whose scale is cut.

    python -m benchmarks.wear_runs DIR [--hands 3] [--left 0.7] [--simulated 10] [--duration-s 6]

DIR keeps what the verbs write: a calibration of ``data/paper-like``, ranges with the worn scale, and for each hand,
drawn from these ranges, the rolling of a bolt.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from skincal.calibration import read_calibration
from skincal.deploy.wear import rescale_calibration
from skincal.ranges import from_calibration, write_ranges

DATA = Path(__file__).parent.parent / "data" / "paper-like"


def skincal(*words: object) -> dict[str, Any]:
    """Run a verb, and return what it prints."""
    command = [sys.executable, "-m", "skincal", *map(str, words), "--json"]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measures; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.wear_runs",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--hands", type=int, default=3)
    parser.add_argument(
        "--left", type=float, default=0.7, help="part of the scale that is left (default 0.7)"
    )
    parser.add_argument("--simulated", type=int, default=10, help="hands to compare with (default 10)")
    parser.add_argument("--duration-s", type=float, default=6.0)
    given = parser.parse_args(arguments)
    given.folder.mkdir(parents=True, exist_ok=True)
    cal, ranges = given.folder / "cal", given.folder / "worn.toml"
    skincal("fit", DATA, "--out", cal, "--seed", 1, "--no-report", "--force")
    worn = rescale_calibration(read_calibration(cal), given.left)
    write_ranges(from_calibration(worn, joint=True), ranges, force=True)
    for hand in range(given.hands):
        rolled = given.folder / f"rolled-{hand}"
        options = [f"--driver-option={option}" for option in ("task=bolt", f"ranges={ranges.resolve()}")]
        skincal(
            *("deploy", "bolt", "bolt-tactile-1", *options, "--seed", hand),
            *("--duration-s", given.duration_s, "--out", rolled, "--force"),
        )
        found = skincal("rescale", cal, rolled, "--hands", given.simulated)
        low, high = found["interval"]
        enough = "" if found["enough"] else "; one factor is not enough"
        print(
            f"{found['factor']:.2f} ({low:.2f} to {high:.2f}, {found['level']:.0%}; {found['hands']} hands){enough}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
