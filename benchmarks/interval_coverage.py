"""Coverage study: how often the intervals of the fit hold the truth, and how wide they are for it.

Makes seeded sessions of each contact law (:mod:`benchmarks.sessions`), fits each with skincal's default options as
``skincal fit`` does, and compares with the truth *as the positions tell it*. From the project's root::

    python -m benchmarks.interval_coverage --sessions 100 --out coverage.json

Every finished session is appended to ``coverage.jsonl`` beside the output; run again, the study goes on from there,
or grows when ``--sessions`` does. Session i of a law depends on the seed, the law and i only, so neither the number of
workers nor an interruption changes a number. Each worker fits one session at a time on one core.

With ``--keep FILE`` the sessions are also kept in short. With ``--kept FILE`` nothing is fitted: sessions that were
kept are counted again, with their intervals as the fit makes them today::

    python -m benchmarks.interval_coverage --kept benchmarks/results/coverage_sessions.jsonl.gz --out coverage.json

With ``--first N`` only the first N usable presses of every session are fitted: what few presses tell.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from benchmarks.coverage_kept import as_shipped, read_kept, write_kept
from benchmarks.coverage_store import SCHEDULER, Store, finished
from benchmarks.coverage_tables import as_text, summary
from benchmarks.sessions import CYLINDER_RADIUS_M, Law, LayerRanges, Truth, make_session
from skincal.calibrate import calibrate, fit_problem
from skincal.errors import SkincalError
from skincal.fitting.conclude import interval
from skincal.fitting.fit_options import FitOptions, GridSteps
from skincal.fitting.result import OPEN, PARAMETERS, FitResult
from skincal.version import __version__
from skincal.workers.processes import available_cores

Record = dict[str, Any]
Floats = NDArray[np.float64]

LAWS: tuple[Law, ...] = get_args(Law)
LEVELS = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995)
QUANTILES = (
    0.0,
    0.0025,
    0.005,
    0.01,
    0.025,
    0.05,
    0.1,
    0.25,
    0.5,
    0.75,
    0.9,
    0.95,
    0.975,
    0.99,
    0.995,
    0.9975,
    1.0,
)


COARSE = GridSteps(1.2e-3, 0.5e-3, math.radians(5.0), 12)
"""A grid a tenth of the default's size; what follows it, and so the intervals, is the default's."""


@dataclass(frozen=True)
class Job:
    """One session to make and to fit."""

    seed: int
    law: Law
    index: int
    options: FitOptions = field(default_factory=FitOptions)
    layers: LayerRanges = field(default_factory=LayerRanges)
    first: int | None = None

    @property
    def key(self) -> tuple[str, int]:
        """Key of the session in the study."""
        return self.law, self.index


def run_job(job: Job) -> Record:
    """Makes a session, fits it, and says how the result stands to the truth."""
    rng = np.random.default_rng([job.seed, LAWS.index(job.law), job.index])
    session, truth = make_session(rng, job.law, layers=job.layers)
    if job.first is not None:
        session = replace(
            session, presses=session.presses.select(fit_problem(session, job.options).rows[: job.first])
        )
    record: Record = {"law": job.law, "index": job.index, "truth": truth.plain()}
    start = time.perf_counter()
    try:
        result = calibrate(session, options=job.options, seed=job.index, workers=1).result
    except SkincalError as error:
        return record | {"failed": str(error)}
    seconds = time.perf_counter() - start
    # The table of levels is worth nothing if the fit makes its intervals in another way.
    if intervals_at(result, job.options.level) != {n: list(result.intervals[n]) for n in PARAMETERS}:
        raise RuntimeError("intervals_at no longer makes the intervals as the fit does; bring it up to date")
    return record | {"seconds": seconds} | compared(result, truth)


def compared(result: FitResult, truth: Truth) -> Record:
    """Compare a fit with the truth, in the fit's own units [m, rad, Pa/m, 1/N]."""
    told = told_values(truth)
    clouds = contact_laws(result)
    return {
        "told": told,
        "best": dict(result.best),
        "intervals": {name: list(result.intervals[name]) for name in PARAMETERS},
        "levels": {str(level): intervals_at(result, level) for level in LEVELS},
        "quantiles": {n: [np.quantile(c[n], QUANTILES).tolist() for c in clouds] for n in PARAMETERS},
        "rank": {n: [float((c[n] < told[n]).mean()) for c in clouds] for n in PARAMETERS},
        "box": asdict(result.box),
        "mse_counts2": result.mse_counts2,
        "valley_mse_counts2": result.valley_mse_counts2,
        "sigmas": asdict(result.sigmas),
        "law_spread_m": result.law_spread_m,
        "effective_draws": result.effective_draws,
        "presses_used": len(result.problem),
        "findings": [finding.code for finding in result.findings],
        "no_interval": not result.gives_intervals,
        "readings_to_spare": result.problem.readings - result.problem.unknowns,
    }


def contact_laws(result: FitResult) -> list[dict[str, Floats]]:
    """The draws of a fit by parameter, for each contact law: the foundation, and one that spreads pressure."""
    return [dict(zip(PARAMETERS, half.T, strict=True)) for half in np.array_split(result.draws, 2)]


def intervals_at(result: FitResult, level: float) -> dict[str, list[float]]:
    """The intervals that the fit would have given at another level."""
    if not result.gives_intervals:
        return {name: list(OPEN) for name in PARAMETERS}
    clouds = contact_laws(result)
    return {
        n: list(interval(n, [c[n] for c in clouds], result.best[n], result.box, level)) for n in PARAMETERS
    }


def told_values(truth: Truth) -> dict[str, float]:
    """The truth as the positions tell it, by the names of the fit's parameters."""
    told = truth.as_positions_tell
    pose = (float(np.radians(told.beta_deg)) * CYLINDER_RADIUS_M, told.y_m, float(np.radians(told.alpha_deg)))
    return dict(zip(PARAMETERS, (*pose, told.elasticity_pa_per_m, told.scale_per_n), strict=True))


def run_all(
    store: Store,
    jobs: Sequence[Job],
    workers: int,
    progress: Callable[[Iterable[Record], int], Iterable[Record]],
    scheduler: str | None = None,
) -> None:
    """Runs what is not done yet; each session is kept as soon as it is."""
    done = store.done
    missing = [job for job in jobs if job.key not in done]
    for record in progress(finished(run_job, missing, workers, scheduler), len(missing)):
        store.add(record)


def strict_json(value: Any) -> Any:
    """The same with None for numbers that JSON does not have: NaN and infinity."""
    if isinstance(value, dict):
        return {key: strict_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [strict_json(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _bar(records: Iterable[Record], total: int) -> Iterable[Record]:
    from rich.console import Console
    from rich.progress import track

    return track(records, "sessions", total=total, console=Console(stderr=True))


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    add = parser.add_argument
    pair = {"type": float, "nargs": 2, "metavar": ("LOW", "HIGH")}
    add("--law", choices=(*LAWS, "both"), default="both", help="contact law of the sessions")
    add("--sessions", type=int, default=100, help="sessions of each law (default 100)")
    add("--seed", type=int, default=0)
    add(
        "--coarse-grid",
        action="store_true",
        help="the grid only gives starting points: 9 000 combinations do",
    )
    add("--workers", type=int, default=available_cores(), help="default: one a core")
    add("--scheduler", metavar="ADDRESS", help=SCHEDULER)
    add("--out", type=Path, default=Path("coverage.json"), help="summary to write (default coverage.json)")
    add("--thickness-mm", **pair, default=(1.0, 2.5), help="of the layers (default 1 2.5)")
    add("--first", type=int, help="fit only so many usable presses of each session")
    add("--keep", type=Path, help="also keep the sessions in short, compressed (.jsonl.gz)")
    add("--kept", type=Path, help="fit nothing; count sessions that were kept")
    add("--poisson", **pair, default=(0.3, 0.45), help="of the layers (default 0.3 0.45)")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    given = _parser().parse_args(arguments)
    try:
        study, records = read_kept(given.kept) if given.kept is not None else _fitted(given)
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    if given.keep is not None:
        write_kept(given.keep, study, records)
    level = float(study["options"]["level"])
    found = summary([as_shipped(r, study["quantiles"], LEVELS, level) for r in records], level)
    told = {key: value for key, value in study.items() if key != "quantiles"}
    content = json.dumps(strict_json({"study": told, "laws": found}), indent=1)
    given.out.write_text(content + "\n", encoding="utf-8")
    print(as_text(found))
    return 0


def _fitted(given: argparse.Namespace) -> tuple[Record, list[Record]]:
    """The study that is asked for and its sessions, fitted as far as they are not yet.

    Raises:
        ValueError: the file of the sessions holds another study.
    """
    laws: tuple[Law, ...] = LAWS if given.law == "both" else (given.law,)
    options = FitOptions(steps=COARSE) if given.coarse_grid else FitOptions()
    thin, thick = given.thickness_mm
    layers = LayerRanges((thin * 1e-3, thick * 1e-3), tuple(given.poisson))
    indices = range(given.sessions)
    jobs = [Job(given.seed, law, index, options, layers, given.first) for index in indices for law in laws]
    study: Record = {"seed": given.seed, "version": __version__, "options": asdict(options)}
    study |= {"layers": asdict(layers), "quantiles": QUANTILES}
    if given.first is not None:
        study["first"] = given.first
    store = Store(given.out.with_suffix(".jsonl"), study)
    run_all(store, jobs, given.workers, _bar, given.scheduler)
    return study, store.of(job.key for job in jobs)


if __name__ == "__main__":
    sys.exit(main())
