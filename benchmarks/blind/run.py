"""Runs the blind test: makes each session, fits it, diagnoses it, and keeps what ``skincal diagnose`` said.

    python -m benchmarks.blind run --out DIR                        # all sessions, hours
    python -m benchmarks.blind run --out DIR --suite none,decoy --limit 5
    python -m benchmarks.blind run --out DIR --quick                # without the grid of a fit: a fifth of the time

What DIR holds: ``results/NAME.json``, a session each, with the wall and the processor time of both commands;
``labels/NAME.sealed``, what is hidden, which only ``python -m benchmarks.blind score`` opens. A session that has a
result is skipped, so the same command goes on where it was interrupted, and a larger one adds to it; with other code it
is another test, and refused. Commands get a folder whose name tells nothing. Sessions of all suites take turns: half a
run is half of each suite.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from benchmarks.blind.bench import COARSE, Bench, RunError
from benchmarks.blind.kept import check_study
from benchmarks.blind.suites import SUITES, specs
from benchmarks.blind.truth.spec import Spec
from benchmarks.coverage_store import SCHEDULER, finished

Record = dict[str, Any]


def planned(suites: Sequence[str], seed: int, limit: int | None) -> list[Spec]:
    """The sessions of some suites, in turns, so that a part of them is a part of each suite."""
    found: list[tuple[float, Spec]] = []
    for suite in suites:
        chosen = specs(suite, seed)[:limit]
        found += [((n + 0.5) / len(chosen), spec) for n, spec in enumerate(chosen)]
    return [spec for _, spec in sorted(found, key=lambda pair: pair[0])]


def code_version() -> str | None:
    """The commit of this code, with a hash of what was changed since where files differ; None outside a checkout."""
    git = ["git", "-C", str(Path(__file__).parent)]
    try:
        said, changed = (
            subprocess.run([*git, *own], capture_output=True, check=True).stdout
            for own in (["describe", "--always", "--dirty", "--abbrev=12"], ["diff", "HEAD"])
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    told = said.decode().strip()
    return f"{told}-{hashlib.sha256(changed).hexdigest()[:8]}" if changed else told


def check_diagnose(bench: Bench) -> None:
    """Refuses to begin with a skincal that cannot diagnose.

    Raises:
        RunError: it cannot.
    """
    if bench.skincal("diagnose", "--help").status != 0:
        raise RunError(
            "skincal diagnose: expected a verb of this name, this skincal has none; install one that has"
        )


def run_all(
    bench: Bench,
    wanted: Sequence[Spec],
    workers: int,
    tell: Callable[[str], None],
    scheduler: str | None = None,
) -> int:
    """Runs the sessions that have no result; returns how many failed."""
    failed = 0
    for number, record in enumerate(_records(bench, wanted, workers, scheduler), start=1):
        ok = all(record.get(verb, {}).get("status") == 0 for verb in ("fit", "diagnose"))
        failed += not ok
        tell(f"{number} of {len(wanted)}: {record['session']} {_times(record)}{'' if ok else ' FAILED'}")
    return failed


def _records(bench: Bench, wanted: Sequence[Spec], workers: int, scheduler: str | None) -> Iterator[Record]:
    if scheduler is not None:
        yield from finished(bench.run, wanted, workers, scheduler)
        return
    with ThreadPoolExecutor(workers) as pool:
        try:
            for future in as_completed([pool.submit(bench.run, spec) for spec in wanted]):
                yield future.result()
        except BaseException:
            bench.stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _times(record: Record) -> str:
    verbs = [verb for verb in ("fit", "diagnose") if verb in record]
    return ", ".join(
        f"{verb} {record[verb]['wall_s']:.0f} s ({record[verb]['cpu_s']:.0f} s)" for verb in verbs
    )


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.blind run", description=__doc__, formatter_class=raw
    )
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder of the test; with one that is there, it goes on")
    add("--suite", default=",".join(SUITES), help=f"some of {','.join(SUITES)} (default all)")
    add("--limit", type=int, help="only so many sessions of each suite")
    add("--workers", type=int, default=1, help="sessions at a time, each on about one core (default 1)")
    add("--scheduler", metavar="ADDRESS", help=f"{SCHEDULER}; they share the folder of --out")
    add("--seed", type=int, default=0, help="of the whole test (default 0)")
    add("--retry", action="store_true", help="run again what failed")
    add("--keep", action="store_true", help="keep datasets and calibrations")
    add("--timeout", type=float, default=3600.0, help="seconds for a command (default 3600)")
    add(
        "--quick",
        action="store_true",
        help="in this process, from the engine's own base model instead of a fit",
    )
    default = "--no-cache --no-report --workers 1"
    help_text = f"for the diagnosis, such as --diagnose-options=--thorough (default {default})"
    add("--diagnose-options", default=default, metavar="TEXT", help=help_text)
    return parser


def _study(seed: int, extra: Sequence[str], quick: bool) -> Record:
    """Return everything that the sessions depend on; results of other code belong to another test."""
    options = {"diagnose_options": list(extra), "fit_options": list(COARSE)}
    return {"seed": seed, "code": code_version(), **(options if not quick else {"quick": True})}


def _has_result(file: Path, retry: bool) -> bool:
    if not file.exists():
        return False
    record = json.loads(file.read_text(encoding="utf-8"))
    return not retry or record.get("diagnose", {}).get("status") == 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the test; returns the exit status: 1 if a session failed, 2 if it could not begin."""
    parser = _parser()
    given = parser.parse_args(arguments)
    suites = given.suite.split(",")
    if unknown := [suite for suite in suites if suite not in SUITES]:
        parser.error(f"--suite: expected some of {', '.join(SUITES)}; got {', '.join(unknown)}")
    extra = tuple(shlex.split(given.diagnose_options))
    bench = Bench(given.out, given.keep, given.timeout, extra=extra, quick=given.quick)
    try:
        check_diagnose(bench)
        check_study(given.out, _study(given.seed, extra, given.quick))
    except RunError as error:
        print(error, file=sys.stderr)
        return 2
    wanted = planned(suites, given.seed, given.limit)
    missing = [spec for spec in wanted if not _has_result(bench.result_file(spec), given.retry)]
    print(f"{len(wanted)} sessions, {len(missing)} to run", file=sys.stderr)
    # A run that is asked to end takes the commands that it started with it.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        failed = run_all(
            bench, missing, given.workers, lambda text: print(text, file=sys.stderr), given.scheduler
        )
    except KeyboardInterrupt:
        print("interrupted; the same command goes on", file=sys.stderr)
        return 130
    return 1 if failed else 0
