"""Coverage of intervals from few presses, with and without readings to spare.

Fits the first few usable presses of seeded sessions, and counts the intervals that the draws would give, whether the
fit gives them or not: it gives none where there are few presses and no more readings than unknowns
(:attr:`skincal.fitting.problem.FitProblem.determined`). From the project's root::

    python -m benchmarks.coverage_few --out coverage_few.json

Runs on one core a session, some ten minutes on two.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.coverage_kept import as_shipped
from benchmarks.coverage_store import SCHEDULER, finished
from benchmarks.interval_coverage import COARSE, LEVELS, QUANTILES, Job, run_job
from skincal.fitting.fit_options import FitOptions
from skincal.fitting.result import PARAMETERS
from skincal.workers.processes import available_cores

Record = dict[str, Any]

PRESSES = (3, 5, 8)
SESSIONS, SEED = 16, 77


def counted(records: Iterable[Record], level: float) -> list[Record]:
    """A row for each number of presses, without and with readings to spare.

    Args:
        records: of sessions.
        level: probability content of the intervals.
    """
    groups: dict[tuple[int, bool], list[int]] = {}
    for record in records:
        if "failed" in record:
            continue
        key = record["presses_used"], record["readings_to_spare"] > 0
        groups.setdefault(key, []).append(_held(record, level))
    return [
        {
            "presses": presses,
            "readings beyond the unknowns": "some" if spare else "none",
            "sessions": len(held),
            f"intervals of {100 * level:g} % that hold the truth": f"{sum(held)} of {len(PARAMETERS) * len(held)}",
        }
        for (presses, spare), held in sorted(groups.items())
    ]


def _held(record: Record, level: float) -> int:
    """Count the parameters with the truth in the interval of the draws."""
    plain = {key: value for key, value in record.items() if key != "levels"} | {"no_interval": False}
    intervals = as_shipped(plain, QUANTILES, LEVELS, level)["intervals"]
    return sum(low <= record["told"][name] <= high for name, (low, high) in intervals.items())


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--presses", type=int, nargs="+", default=PRESSES)
    parser.add_argument("--sessions", type=int, default=SESSIONS, help="of each number of presses")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--workers", type=int, default=available_cores())
    parser.add_argument("--scheduler", metavar="ADDRESS", help=SCHEDULER)
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    given = parser.parse_args(arguments)
    options = FitOptions(steps=COARSE)
    jobs = [
        Job(given.seed, "foundation", index, options, first=count)
        for count in given.presses
        for index in range(given.sessions)
    ]
    rows = counted(finished(run_job, jobs, given.workers, given.scheduler), options.level)
    text = json.dumps({"sessions": rows}, indent=1)
    print(text)
    if given.out is not None:
        given.out.write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
