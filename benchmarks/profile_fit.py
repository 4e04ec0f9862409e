"""Where the time of a fit goes: processor time by package, of one process.

    python -m benchmarks.profile_fit [DATASET] [--out FILE]

Looks a hundred times a second of processor time which package's function is running. What C does, numpy's and the
compiled routine's work included, counts for the function that called it.
"""

# ruff: noqa: E402 - the number of threads is read when numpy is imported
from __future__ import annotations

import os

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[_threads] = "1"

import argparse
import json
import re
import signal
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

SAMPLE = "data/paper-like"
_PLACE = re.compile(r".*(?:site-packages|lib/python3\.\d+)/(\w+)")
_EVERY_S = 0.01
_LEAST = 0.01
"""Packages with a smaller part of the time are put together."""


def package(file: str) -> str:
    """The package that a file belongs to; parts of skincal one level deeper."""
    if (at := file.rfind("/skincal/")) >= 0:
        return "skincal." + file[at + 9 :].split("/")[0].removesuffix(".py")
    found = _PLACE.match(file)
    return "other" if found is None else found[1]


def by_package(work: Callable[[], object]) -> dict[str, float]:
    """Parts of the processor time of some work, the largest first."""
    seen: Counter[str] = Counter()

    def look(_: int, frame: FrameType | None) -> None:
        seen["other" if frame is None else package(frame.f_code.co_filename)] += 1

    before = signal.signal(signal.SIGPROF, look)
    signal.setitimer(signal.ITIMER_PROF, _EVERY_S, _EVERY_S)
    try:
        work()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    whole = max(seen.total(), 1)
    parts = {name: count / whole for name, count in seen.most_common() if count >= _LEAST * whole}
    return {
        **{name: round(part, 3) for name, part in parts.items()},
        "the rest": round(1 - sum(parts.values()), 3),
    }


def measure(dataset: str) -> dict[str, Any]:
    """A fit in this process, imports and the loading of compiled code included."""
    from skincal.calibrate import calibrate
    from skincal.dataset import read_dataset

    begin = time.process_time()
    parts = by_package(lambda: calibrate(read_dataset(Path(dataset)), workers=1))
    return {
        "dataset": dataset,
        "processor time [s]": round(time.process_time() - begin, 2),
        "part of the time": parts,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", nargs="?", default=SAMPLE)
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    given = parser.parse_args(arguments)
    text = json.dumps(measure(given.dataset), indent=1)
    print(text)
    if given.out is not None:
        given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
