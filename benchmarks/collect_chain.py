"""Study of the whole chain on the simulated hand: forces and places that sessions reach, and what a fit makes of them.

Collects sessions with the driver ``sim``, each seed with a truth of its own, and compares what the joints tell with
what truly touched. With ``--fit`` each session is fitted as ``skincal fit`` does it, and the hidden truth looked for in
the intervals. From the project's root::

    python -m benchmarks.collect_chain --seeds 20 --out chain.json
    python -m benchmarks.collect_chain --seeds 100 --fit --out chain_fit.json

Every finished session is appended to a ``.jsonl`` beside the output; run again, the study goes on from there, or grows
when ``--seeds`` does.

A constant error of the measured positions cannot be told from the pose of the sensor. The truth of y and beta is
therefore taken *as the positions tell it*, from the truth file: with the mean error of the positions, over all contacts
of the session, put into the pose. In the same way a constant relative error of the measured forces cannot be told from
the scale S; S is compared as it is, and also as the forces tell it.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.coverage_store import SCHEDULER, Store, finished
from benchmarks.coverage_tables import wilson
from benchmarks.interval_coverage import COARSE, strict_json
from skincal.calibrate import calibrate
from skincal.collect import PROTOCOLS, Collected, Mount, Need, Progress, collect
from skincal.dataset import Dataset, active_taxels
from skincal.dataset.rest import active_threshold
from skincal.errors import SkincalError
from skincal.fitting.fit_options import FitOptions
from skincal.hand.sim import SimDriver
from skincal.version import __version__
from skincal.workers.processes import available_cores

Record = dict[str, Any]
Floats = NDArray[np.float64]

QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
SETTLE_S = 0.15
TOLD = (
    "y_m",
    "beta_deg",
    "alpha_deg",
    "elasticity_pa_per_m",
    "scale_per_n",
    "scale_per_n as the forces tell it",
)


@dataclass(frozen=True)
class Job:
    """One session."""

    protocol: str
    seed: int
    fit: bool
    coarse: bool

    @property
    def key(self) -> tuple[str, int]:
        """Key of the session in the study."""
        return self.protocol, self.seed


@dataclass(frozen=True)
class Seen:
    """A session, what truly touched in each of its holds, and the hidden truth."""

    collected: Collected
    true_force_n: Floats
    true_point_m: Floats
    truth: dict[str, float]
    as_positions_tell: dict[str, float]
    seconds: float

    @property
    def dataset(self) -> Dataset:
        """The session's data."""
        return self.collected.dataset


def session(protocol: str, seed: int, folder: Path) -> Seen:
    """Collects a session of a seed, as ``skincal collect --driver sim`` does."""
    start = time.perf_counter()
    drivers: list[SimDriver] = []
    truth: list[tuple[float, ...]] = []

    def make(need: Need) -> SimDriver:
        drivers.append(SimDriver(seed=seed, truth_path=folder / "truth.json"))
        return drivers[-1]

    def watch(progress: Progress) -> None:
        contact = drivers[-1].simulated.contact()
        truth.append((progress.sample.time_s, contact.force_n, *contact.point_m))

    description = SimDriver(seed=seed).description
    layout = Mount.of(description.meta).layout
    plan = PROTOCOLS[protocol](np.random.default_rng([seed, len(protocol)]), layout)
    collected = collect(plan, description, make, folder / "run", watch=watch)
    seconds = time.perf_counter() - start
    times, force, *point = np.array(truth).T
    presses = collected.dataset.presses
    rows = [
        (times >= begin + SETTLE_S) & (times <= end)
        for begin, end in zip(presses.columns["t_hold_s"], presses.columns["t_release_s"], strict=True)
    ]
    true_force = np.array([force[row].mean() if row.any() else np.nan for row in rows])
    place = np.transpose(point)
    true_point = np.array([place[row].mean(axis=0) if row.any() else np.full(3, np.nan) for row in rows])
    drawn = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    told = drawn["session"]["truth_as_the_positions_tell_it"]
    return Seen(collected, true_force, true_point, drawn["model"], told, seconds)


def run_job(job: Job) -> Record:
    """Collects a session, fits it if wanted, and says how both stand to the truth."""
    record: Record = {"law": job.protocol, "index": job.seed}
    with tempfile.TemporaryDirectory() as folder:
        try:
            seen = session(job.protocol, job.seed, Path(folder))
            record |= reached(seen)
            return record | (fitted(seen, job) if job.fit else {})
        except SkincalError as error:
            return record | {"failed": str(error)}


def reached(seen: Seen) -> Record:
    """Forces and places that were reached, against those commanded and the true ones."""
    presses = seen.dataset.presses
    target = presses.columns["target_force_n"]
    arc, along = position_errors(seen)
    held = np.isfinite(seen.true_force_n)
    return {
        "seconds": seen.seconds,
        "session_s": seen.collected.session_s,
        "presses": len(presses),
        "missed_target": seen.collected.missed_target,
        "status": seen.collected.statuses,
        "force_error_n": (presses.force_n - target)[held].tolist(),
        "force_error_share": ((presses.force_n - target) / target)[held].tolist(),
        "true_force_error_share": ((seen.true_force_n - presses.force_n) / presses.force_n)[held].tolist(),
        "position_error_arc_m": arc[held].tolist(),
        "position_error_along_m": along[held].tolist(),
        "shear_share": np.hypot(presses.columns["shear_u_n"], presses.columns["shear_v_n"])[held].tolist(),
        "slip_m": presses.columns["slip_m"][held].tolist(),
    }


def position_errors(seen: Seen) -> tuple[Floats, Floats]:
    """Measured less true contact points round and along the finger (K,) [m]."""
    radius = seen.dataset.meta.surface.radius_m
    assert radius is not None
    points = (seen.dataset.presses.position_m, seen.true_point_m)
    measured, true = (radius * np.arctan2(p[:, 0], p[:, 2]) for p in points)
    return measured - true, points[0][:, 1] - points[1][:, 1]


def fitted(seen: Seen, job: Job) -> Record:
    """The intervals of the fit beside the truth as the data tell it."""
    start = time.perf_counter()
    options = FitOptions(steps=COARSE) if job.coarse else FitOptions()
    outcome = calibrate(seen.dataset, options=options, seed=job.seed, workers=1)
    told = told_truth(seen, options)
    intervals = {name: list(interval) for name, interval in outcome.calibration.intervals.items()}
    intervals[TOLD[-1]] = intervals["scale_per_n"]
    return {
        "truth": seen.truth,
        "told": told,
        "best": outcome.calibration.model.best(),
        "intervals": intervals,
        "mse_counts2": outcome.result.mse_counts2,
        "presses_used": len(outcome.result.problem),
        "findings": [finding.code for finding in outcome.result.findings],
        "fit_seconds": time.perf_counter() - start,
    }


def told_truth(seen: Seen, options: FitOptions) -> dict[str, float]:
    """The truth as the measured positions tell it, and the scale also as the forces tell it."""
    threshold = active_threshold(seen.dataset) if options.active_counts is None else options.active_counts
    used = active_taxels(seen.dataset, threshold).sum(axis=1) >= (options.min_active or 2)
    used &= np.isfinite(seen.true_force_n)
    force = seen.dataset.presses.force_n
    share = float(np.sum(seen.true_force_n[used]) / np.sum(force[used]))
    return seen.truth | seen.as_positions_tell | {TOLD[-1]: seen.truth["scale_per_n"] * share}


def summary(records: Sequence[Record]) -> Record:
    """Summarize the sessions of each protocol."""
    protocols = list(dict.fromkeys(r["law"] for r in records))
    return {name: _group([r for r in records if r["law"] == name]) for name in protocols}


def _group(records: Sequence[Record]) -> Record:
    good = [r for r in records if "failed" not in r]
    found: Record = {"sessions": len(records), "failed": len(records) - len(good)}
    if not good:
        return found
    per_press = {
        name: _spread([value for r in good for value in r[name]])
        for name in (
            "force_error_n",
            "force_error_share",
            "true_force_error_share",
            "position_error_arc_m",
            "position_error_along_m",
            "slip_m",
        )
    }
    presses = sum(r["presses"] for r in good)
    found |= {
        "presses": presses,
        "missed_target": sum(r["missed_target"] for r in good),
        "session_s_median": float(np.median([r["session_s"] for r in good])),
        "seconds_median": float(np.median([r["seconds"] for r in good])),
        "distributions": per_press,
    }
    fits = [r for r in good if "intervals" in r]
    if fits:
        found["coverage"] = {name: _covered(name, fits) for name in TOLD}
        found["presses_used_median"] = float(np.median([r["presses_used"] for r in fits]))
        found["fit_seconds_median"] = float(np.median([r["fit_seconds"] for r in fits]))
    return found


def _spread(values: Sequence[float]) -> Record:
    quantiles = np.quantile(values, QUANTILES)
    return {f"{100 * q:g} %": float(v) for q, v in zip(QUANTILES, quantiles, strict=True)}


def _covered(name: str, fits: Sequence[Record]) -> Record:
    inside = [r["intervals"][name][0] <= r["told"][name] <= r["intervals"][name][1] for r in fits]
    low, high = wilson(sum(inside), len(inside))
    width = np.median([np.diff(r["intervals"][name])[0] for r in fits])
    return {"inside": sum(inside), "of": len(inside), "low": low, "high": high, "median_width": float(width)}


def run_all(store: Store, jobs: Sequence[Job], workers: int, scheduler: str | None = None) -> None:
    """Runs what is not done yet; each session is kept as soon as it is."""
    missing = [job for job in jobs if job.key not in store.done]
    for number, record in enumerate(finished(run_job, missing, workers, scheduler), start=1):
        store.add(record)
        print(f"{number} of {len(missing)} sessions", file=sys.stderr)


def tables(found: Record) -> Record:
    """The summary as tables, for a page: one of the protocols, and two for each of them."""
    inner = ("distributions", "coverage")
    content: Record = {
        "sessions": {
            name: {k: v for k, v in group.items() if k not in inner} for name, group in found.items()
        }
    }
    for name, group in found.items():
        content |= {f"{name}, {key}": group[key] for key in inner if key in group}
    return content


def as_text(found: Record) -> str:
    """The summary for a person."""
    lines: list[str] = []
    for protocol, group in found.items():
        lines.append(f"{protocol}: {group['sessions']} sessions, {group['failed']} failed")
        if "presses" in group:
            lines.append(
                f"  {group['presses']} presses, {group['missed_target']} missed their target; a session takes "
                f"{group['session_s_median']:.0f} s of the hand's clock, {group['seconds_median']:.0f} s of ours"
            )
            lines += [f"  {name}: {_row(spread)}" for name, spread in group["distributions"].items()]
        lines += [
            f"  {name}: {c['inside']} of {c['of']} inside, median width {c['median_width']:.4g}"
            for name, c in group.get("coverage", {}).items()
        ]
    return "\n".join(lines)


def _row(spread: Record) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in spread.items())


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    add = parser.add_argument
    add("--protocol", choices=(*PROTOCOLS, "both"), default="full")
    add("--seeds", type=int, default=20, help="sessions of each protocol, seeds from 0 (default 20)")
    add("--first-seed", type=int, default=0)
    add("--fit", action="store_true", help="fit each session, and look for the truth in the intervals")
    add("--coarse-grid", action="store_true", help="fit from fewer starting points, four times as fast")
    add("--workers", type=int, default=available_cores(), help="default: one a core")
    add("--scheduler", metavar="ADDRESS", help=SCHEDULER)
    add("--out", type=Path, default=Path("collect_chain.json"), help="summary to write")
    return parser


def main(arguments: Iterable[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    given = _parser().parse_args(None if arguments is None else list(arguments))
    protocols = PROTOCOLS if given.protocol == "both" else (given.protocol,)
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    jobs = [Job(p, seed, given.fit, given.coarse_grid) for seed in seeds for p in protocols]
    study = {"version": __version__, "fit": given.fit, "coarse_grid": given.coarse_grid}
    try:
        store = Store(given.out.with_suffix(".jsonl"), study)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    run_all(store, jobs, given.workers, given.scheduler)
    found = summary(store.of(job.key for job in jobs))
    content = json.dumps(strict_json({"study": study, **tables(found)}), indent=1)
    given.out.write_text(content + "\n", encoding="utf-8")
    print(as_text(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
