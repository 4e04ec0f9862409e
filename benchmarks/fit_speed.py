"""Time of a fit with the default grid, as a whole process: ``skincal fit``, its report included.

    python benchmarks/fit_speed.py [DATASET] [--out FILE] [-- OPTIONS OF THE FIT]

Other work on the machine makes it longer; how busy it was when the fit began is told with the figures.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from skincal.workers.processes import available_cores

SAMPLE = "data/paper-like"


def measured(dataset: str, options: Sequence[str] = ()) -> dict[str, Any]:
    """Fits a dataset in a process of its own, and says what that took.

    Args:
        dataset: folder to fit.
        options: further options of ``skincal fit``.

    Raises:
        subprocess.CalledProcessError: the fit failed.
    """
    busy = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "cal"
        command = [sys.executable, "-m", "skincal", "fit", dataset, "--out", str(out), *options]
        spent, start = _children_s(), time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        wall, processor = time.perf_counter() - start, _children_s() - spent
        calibration = tomllib.loads((out / "calibration.toml").read_text(encoding="utf-8"))
        return {
            "command": " ".join(["skincal", "fit", dataset, "--out", "cal", *options]),
            "combinations": pq.read_metadata(out / "grid.parquet").num_rows,
            "presses": calibration["loss"]["presses_used"],
            "cores": available_cores(),
            "whole process, report included [s]": round(wall, 1),
            "processor time [s]": round(processor, 1),
            "processes that wanted a core when it began": round(busy, 1),
        }


def _children_s() -> float:
    """Processor time of the processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the figures, and writes them where a file is named."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", nargs="?", default=SAMPLE)
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    given, options = parser.parse_known_args(arguments)
    found = measured(given.dataset, [option for option in options if option != "--"])
    text = json.dumps(found, indent=1)
    print(text)
    if given.out is not None:
        given.out.write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
