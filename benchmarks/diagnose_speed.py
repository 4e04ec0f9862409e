"""Time of a diagnosis, stage by stage.

    python -m benchmarks.diagnose_speed [--effects none,hysteresis] [--seed 7] [--out FILE]

For each effect (or ``none``) the simulated hand makes a full session, a coarse grid fits it, and
:func:`skincal.diagnosis.workflow.diagnose` runs in one process. Wall-clock time depends on what else the machine does.
"""

# ruff: noqa: E402 - the number of threads is read when numpy is imported
from __future__ import annotations

import os

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[_threads] = "1"

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.interval_coverage import COARSE
from skincal.calibrate import calibrate
from skincal.calibration import Calibration
from skincal.collect import Mount, collect, full_plan
from skincal.dataset import Dataset
from skincal.diagnosis.workflow import diagnose
from skincal.fitting.fit_options import FitOptions
from skincal.hand.sim import SimDriver
from skincal.version import __version__

Record = dict[str, Any]


class Stages:
    """Processor and wall-clock time [s] of each stage, from the words that a diagnosis says when one begins."""

    def __init__(self, clock: Callable[[], float] = time.process_time) -> None:
        self.clock = clock
        self.began: list[tuple[str, float]] = []
        self.start = clock()

    def __call__(self, stage: str) -> None:
        """A stage begins; all null sessions are one, and so are all rounds."""
        self.began.append((stage.split(":")[0].rstrip(" 0123456789"), self.clock()))

    def seconds(self) -> dict[str, float]:
        """Processor time by stage, up to now."""
        ends = [at for _, at in self.began[1:]] + [self.clock()]
        found: dict[str, float] = {}
        for (stage, begin), end in zip(self.began, ends, strict=True):
            found[stage] = found.get(stage, 0.0) + end - begin
        return found


def session(effect: str, seed: int, folder: Path) -> Dataset:
    """A full session of the simulated hand with a typical case of an effect; ``none`` for none."""
    effects = {} if effect == "none" else {effect: 1.0}
    hand = SimDriver(seed=seed).description
    plan = full_plan(np.random.default_rng(seed), Mount.of(hand.meta).layout)
    return collect(plan, hand, lambda _: SimDriver(seed=seed, effects=effects), folder / effect).dataset


def timed(data: Dataset, calibration: Calibration, seed: int) -> Record:
    """One diagnosis."""
    stages, wall = Stages(), time.perf_counter()
    found = diagnose(data, calibration, seed=seed, report_stage=stages)
    by_stage = stages.seconds()
    return {
        "verdict": found.verdict,
        "named": ", ".join(e.name for e in found.effects),
        "processor_s": round(sum(by_stage.values()), 1),
        "wall_s": round(time.perf_counter() - wall, 1),
        "by_stage_s": {stage: round(seconds, 1) for stage, seconds in by_stage.items()},
    }


def measure(effects: Sequence[str], seed: int, tell: Callable[[str], None]) -> Record:
    """All diagnoses."""
    runs: list[Record] = []
    stages: dict[str, Record] = {}
    presses = 0
    with tempfile.TemporaryDirectory() as name:
        for effect in effects:
            folder = Path(name)
            data = session(effect, seed, folder)
            presses = len(data.presses)
            tell(f"{effect}: {presses} presses")
            calibration = calibrate(data, options=FitOptions(steps=COARSE), seed=seed).calibration
            one = timed(data, calibration, seed)
            tell(f"{effect}: {one}")
            stages[effect] = one.pop("by_stage_s")
            runs.append({"hidden": effect, **one})
    return {"version": __version__, "presses": presses, "runs": runs, "processor_time_by_stage_s": stages}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measures; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.diagnose_speed",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add(
        "--effects",
        default="none,hysteresis",
        help="hidden effects, one session each (default none,hysteresis)",
    )
    add("--seed", type=int, default=7, help="of the hand and the diagnosis (default 7)")
    add("--out", type=Path, help="file for the times (JSON)")
    given = parser.parse_args(arguments)
    found = measure(given.effects.split(","), given.seed, lambda text: print(text, file=sys.stderr))
    text = json.dumps(found, indent=1) + "\n"
    if given.out:
        given.out.write_text(text, encoding="utf-8")
    else:
        print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
