"""Counts in how many sessions with effects named the new calibration's intervals hold the truth.

    python -m benchmarks.blind run --out DIR --quick --seed N --suite one,two,rest,poor
    python -m benchmarks.blind held DIR... [--out benchmarks/results/blind_held.json]

The truth is that which the measured positions tell: a constant error of the positions is in the pose. E is counted on
skins whose law is the foundation's; of a layer it is an equivalent, which has no truth. Beside all sessions those count
by themselves in which just what is hidden was named. Labels of what was run so far are opened.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.outcome import Outcome
from benchmarks.blind.score import opened
from benchmarks.blind.shares import share

Record = dict[str, Any]

ASKED = 0.95
E, RELATIVE = "elasticity_pa_per_m", ("elasticity_pa_per_m", "scale_per_n")
"""Parameters whose widths are told as parts of the best value."""


def truth_of(label: Record) -> dict[str, float]:
    """What a fit can find of the base model, by the names of a calibration."""
    found = {**label["truth"], **label["truth_as_the_positions_tell_it"]}
    return {k: v for k, v in found.items() if k != E or label["contact_law"] == "linear foundation"}


def held(outcomes: Sequence[Outcome]) -> Record:
    """Shares of sessions with effects named whose intervals hold the truth."""
    some = [o for o in outcomes if o.verdict == "effects" and o.calibrated]
    right = [o for o in some if not o.wrong() and all(o.found(name) for name in o.hidden)]
    return {"all": _counted(some), "right names": _counted(right)}


def _counted(outcomes: Sequence[Outcome]) -> Record:
    found: Record = {}
    every = [_holds(o) for o in outcomes]
    for name in dict.fromkeys(k for one in every for k in one):
        ends = [o.calibrated[name] for o, one in zip(outcomes, every, strict=True) if name in one]
        sizes = [(high - low) / 2 / (best if name in RELATIVE else 1.0) for best, low, high in ends]
        hits = share((one[name] for one in every if name in one), at_least=ASKED)
        found[name] = {**hits, "median half width": float(np.median(sizes))}
    found["all of a session's"] = share(all(one.values()) for one in every)
    return found


def _holds(o: Outcome) -> dict[str, bool]:
    ends = o.calibrated
    return {k: ends[k][1] <= true <= ends[k][2] for k, true in truth_of(o.label).items() if k in ends}


def as_table(found: Record) -> str:
    """The counts as Markdown."""
    lines = ["| sessions | parameter | held | interval, 95 % | half width, median |", "|---|---|---|---|---|"]
    for kind, parameters in found.items():
        for name, one in parameters.items():
            low, high = one["interval_95"]
            wide = f"{one['median half width']:.2g}" if "median half width" in one else ""
            said = f"{one['hits']} of {one['of']} | {100 * low:.0f} to {100 * high:.0f} %"
            lines.append(f"| {kind} | {name} | {said} | {wide} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Counts; returns the exit status."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.blind held", description=__doc__, formatter_class=raw
    )
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR", help="what `run --out` wrote")
    parser.add_argument("--out", type=Path, help="file for the counts (JSON)")
    given = parser.parse_args(arguments)
    studies = [json.loads((folder / "study.json").read_text(encoding="utf-8")) for folder in given.folders]
    outcomes = [o for folder in given.folders for o in opened(folder)[0]]
    found = held(outcomes)
    if given.out:
        content = {"studies": studies, "sessions": len(outcomes), "held": found}
        given.out.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(as_table(found))
    return 0
