"""Coverage of the fit over kinds of sensors: levels at rest, noise, layouts, gains, errors of position.

Each row is a kind of :data:`benchmarks.sensors.KINDS`. Its sessions are fitted, and the truth is looked for in the
intervals of the fit (98 %) and among its draws: there its
ranks are uniform when the posterior is neither too narrow nor too wide (simulation-based calibration). From the
project's root::

    python -m benchmarks.coverage_sensors --sessions 100 --out sensors.json

Every finished session is appended to ``sensors.jsonl`` beside the output; run again, the study goes on from there, or
grows when ``--sessions`` does. ``--kind`` takes some rows only. Session i of a kind depends on the seed, the kind and i
alone. Grid and number of draws are smaller than the default's; the posterior is the default's.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import kstest

from benchmarks.coverage_store import SCHEDULER, Store, finished
from benchmarks.coverage_tables import wilson
from benchmarks.interval_coverage import strict_json
from benchmarks.sensors import KINDS, make
from skincal.calibrate import calibrate
from skincal.errors import SkincalError
from skincal.fitting.fit_options import FitOptions, GridSteps
from skincal.fitting.result import PARAMETERS
from skincal.version import __version__

Record = dict[str, Any]

LEVELS = (0.5, 0.8, 0.9, 0.95)
CHEAP = FitOptions(
    steps=GridSteps(1.2e-3, 1e-3, math.radians(8.0), 8),
    rounds=(9, 36),
    enough_draws=250,
    law_spreads_m=(0.0,),
)
"""A coarse grid, which only gives starting points, fewer draws, and only the contact law that makes the sessions."""


@dataclass(frozen=True)
class Job:
    """One session of a kind."""

    seed: int
    kind: str
    index: int

    @property
    def key(self) -> tuple[str, int]:
        """Key of the session in the study."""
        return self.kind, self.index


def run_job(job: Job) -> Record:
    """Make a session, fit it, and compare with the truth."""
    rng = np.random.default_rng([job.seed, list(KINDS).index(job.kind), job.index])
    session, truth = make(rng, KINDS[job.kind])
    record: Record = {"law": job.kind, "index": job.index, "truth": truth.values()}
    start = time.process_time()
    try:
        result = calibrate(session, options=CHEAP, seed=job.index, workers=1).result
    except SkincalError as error:
        return record | {"failed": str(error)}
    told = truth.values()
    foundation = dict(zip(PARAMETERS, result.draws.T, strict=True))
    return record | {
        "cpu_seconds": time.process_time() - start,
        "best": dict(result.best),
        "intervals": {name: list(result.intervals[name]) for name in PARAMETERS},
        "rank": {name: float((foundation[name] < told[name]).mean()) for name in PARAMETERS},
        "sigma": {name: float(_scaled(name, foundation[name]).std()) for name in PARAMETERS},
        "sigmas": asdict(result.sigmas),
        "effective_draws": result.effective_draws,
        "presses_used": len(result.problem),
        "findings": [finding.code for finding in result.findings],
    }


def _scaled(name: str, values: Any) -> Any:
    """E and S by their logarithm."""
    return np.log(values) if name in PARAMETERS[3:] else np.asarray(values)


def row(records: Sequence[Record]) -> Record:
    """Coverage, widths and ranks of the sessions of one kind."""
    fits = [r for r in records if "failed" not in r]
    found: Record = {"sessions": len(records), "failed": len(records) - len(fits)}
    if not fits:
        return found
    for name in PARAMETERS:
        low, high = np.array([r["intervals"][name] for r in fits], dtype=float).T
        told, best = (np.array([r[key][name] for r in fits]) for key in ("truth", "best"))
        hits = int(((low <= told) & (told <= high)).sum())
        rank = np.array([r["rank"][name] for r in fits])
        error = _scaled(name, best) - _scaled(name, told)
        sigma = np.array([r["sigma"][name] for r in fits])
        found[name] = {
            "held": hits,
            "of": len(fits),
            "held_95": list(wilson(hits, len(fits))),
            "open": int((~np.isfinite(high - low)).sum()),
            "levels": {str(v): float((np.abs(rank - 0.5) <= v / 2).mean()) for v in LEVELS},
            "rank_p": float(kstest(rank, "uniform").pvalue),
            "z_rms": float(np.sqrt(np.mean((error / np.maximum(sigma, 1e-300)) ** 2))),
            "z_mean": float(np.mean(error / np.maximum(sigma, 1e-300))),
            "sigma": float(np.median(sigma)),
        }
    codes = [code for r in fits for code in r["findings"]]
    found["findings"] = {code: codes.count(code) for code in sorted(set(codes))}
    found["least_effective_draws"] = min(r["effective_draws"] for r in fits)
    found["median_cpu_seconds"] = float(np.median([r["cpu_seconds"] for r in fits]))
    return found


NAMES = dict(zip(PARAMETERS, ("beta", "y", "alpha", "E", "S"), strict=True))
"""As pages name the parameters; beta is x on a plane."""


def tables(rows: dict[str, Record]) -> Record:
    """The rows as tables, for a page: what was held of each parameter, how ranks lie, and what else there was."""
    held, ranks, others = dict[str, Record](), dict[str, Record](), dict[str, Record]()
    for kind, found in rows.items():
        told = {title: found[name] for name, title in NAMES.items() if name in found}
        held[kind] = {"sessions": found["sessions"]} | {
            t: f"{p['held']} of {p['of']}" for t, p in told.items()
        }
        ranks[kind] = {title: f"{p['z_mean']:+.2f}, {p['z_rms']:.2f}" for title, p in told.items()}
        others[kind] = {key: value for key, value in found.items() if key not in PARAMETERS}
    whole = {title: _ranks(rows[ALL][name]) for name, title in NAMES.items() if name in rows[ALL]}
    return {"held": held, "calibration": whole, "errors_over_sigma": ranks, "sessions": others}


ALL = "all"


def _ranks(p: Record) -> Record:
    low, high = p["held_95"]
    shares = {f"central {100 * float(v):.0f} %": f"{100 * share:.0f} %" for v, share in p["levels"].items()}
    return {
        "held": f"{p['held']} of {p['of']}",
        "95 % interval of that": f"{100 * low:.0f} to {100 * high:.0f} %",
        **shares,
        "p of even ranks": p["rank_p"],
        "rms error over sigma": p["z_rms"],
        "mean error over sigma": p["z_mean"],
    }


def as_text(content: Record) -> str:
    """The tables in Markdown."""
    lines: list[str] = []
    for title, table in content.items():
        columns = list(dict.fromkeys(key for row in table.values() for key in row))
        lines += [f"{title}", "", f"| kind | {' | '.join(columns)} |", "|" + " --- |" * (len(columns) + 1)]
        lines += [
            f"| {kind} | {' | '.join(_cell(line.get(key, '')) for key in columns)} |"
            for kind, line in table.items()
        ]
        lines.append("")
    return "\n".join(lines)


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kind", nargs="+", choices=tuple(KINDS), default=tuple(KINDS))
    parser.add_argument("--sessions", type=int, default=100, help="of each kind (default 100)")
    parser.add_argument("--first", type=int, default=0, help="number of the first session of a kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--scheduler", metavar="ADDRESS", help=SCHEDULER)
    parser.add_argument("--out", type=Path, default=Path("sensors.json"))
    given = parser.parse_args(arguments)
    indices = range(given.first, given.first + given.sessions)
    jobs = [Job(given.seed, kind, index) for index in indices for kind in given.kind]
    study = {"seed": given.seed, "version": __version__, "options": asdict(CHEAP)}
    try:
        store = Store(given.out.with_suffix(".jsonl"), study)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    done = store.done
    for record in finished(
        run_job, [job for job in jobs if job.key not in done], given.workers, given.scheduler
    ):
        store.add(record)
    records = store.of(job.key for job in jobs)
    rows = {kind: row([r for r in records if r["law"] == kind]) for kind in given.kind}
    content = tables(rows | {ALL: row(records)})
    given.out.write_text(
        json.dumps(strict_json({"study": {"seed": given.seed, "version": __version__}, **content}), indent=1)
        + "\n",
        encoding="utf-8",
    )
    print(as_text(content))
    return 0


if __name__ == "__main__":
    sys.exit(main())
