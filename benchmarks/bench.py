"""All benchmarks of speed in one run, their figures in ``benchmarks/results``, and the page that shows them.

    python -m benchmarks.bench [--only model_speed,scaling] [--results FOLDER]

Each runs in a process of its own, one after the other; one that fails is named at the end and leaves its old figures.
``bench.json`` says when and where they were measured. ``docs/performance.md`` shows the files. About eight minutes on
two cores, which should have nothing else to do.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from benchmarks.model_speed import cpu_model
from skincal.version import __version__

RESULTS = Path(__file__).parent / "results"
PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "embreex", "pybullet", "mujoco", "numba-cuda")
MODULES: dict[str, list[str]] = {
    "model_speed": ["--json"],
    "scaling": ["--out", "OUT"],
    "fit_speed": ["--out", "OUT"],
    "profile_fit": ["--out", "OUT"],
    "diagnose_speed": ["--effects", "none", "--out", "OUT"],
    "dataset_load": ["--frames", "300000", "--out", "OUT"],
    "sim_speed": ["--json"],
    "env_speed": ["--steps", "400", "--json"],
    "mujoco_sensors": ["--out", "OUT"],
    "gpu": ["--out", "OUT"],
}
"""Benchmarks and their options; what prints its figures instead of writing them to OUT has ``--json``."""
OPTIONAL = ("mujoco_sensors", "gpu")
"""They need a package or a device, and are left out where it is not there."""
NOT_THERE, MISSED = 2, 1
"""Exit statuses: bad input, so for a device or package that is not there; an aim that was missed."""
COMMANDS: dict[str, list[str]] = {
    "collect, the full protocol of the simulated hand": [
        "collect",
        "--driver",
        "sim",
        "--seed",
        "1",
        "--out",
        "session",
    ],
    "fit of it": ["fit", "session", "--out", "cal"],
    "diagnose it": ["diagnose", "session", "cal", "--out", "diagnosis"],
}
"""Whole commands, each of which needs the ones before."""


def commands() -> dict[str, Any]:
    """Wall-clock and processor time and peak memory of whole commands, their children's included."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for name, words in COMMANDS.items():
            begin = time.perf_counter()
            child = subprocess.Popen(
                [sys.executable, "-m", "skincal", *words],
                cwd=folder,
                stdout=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
            )
            _, status, used = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
            if child.returncode:
                raise subprocess.CalledProcessError(child.returncode, words)
            rows.append(
                {
                    "command": f"skincal {' '.join(words)}",
                    "what": name,
                    "wall clock [s]": round(time.perf_counter() - begin, 1),
                    "processor [s]": round(used.ru_utime + used.ru_stime, 1),
                    "peak memory of a process [MB]": round(used.ru_maxrss / 1024),
                }
            )
    return {"cores": os.cpu_count(), "commands": rows}


def module(name: str, options: Sequence[str]) -> dict[str, Any] | None:
    """The figures of a benchmark; None where it needs what is not there."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.json"
        words = [sys.executable, "-m", f"benchmarks.{name}", *(o.replace("OUT", str(out)) for o in options)]
        done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=False)
        if name in OPTIONAL and done.returncode == NOT_THERE:
            return None
        if done.returncode not in (0, MISSED) or (done.returncode and "--json" not in options):
            raise subprocess.CalledProcessError(done.returncode, words)
        return json.loads(out.read_text(encoding="utf-8") if out.exists() else done.stdout)


def where() -> dict[str, Any]:
    """When, on what and with what it was measured."""
    versions: dict[str, str] = {}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "date": datetime.date.today().isoformat(),
        "processor": cpu_model(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "Python": platform.python_version(),
        "skincal": __version__,
        "processes that wanted a core when it began": round(os.getloadavg()[0], 1),
        **versions,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    parts: dict[str, Callable[[], dict[str, Any] | None]] = {
        **{
            name: lambda name=name, options=options: module(name, options)
            for name, options in MODULES.items()
        },
        "commands": commands,
    }
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", help=f"some of {', '.join(parts)}")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of the figures")
    given = parser.parse_args(arguments)
    chosen = list(parts) if given.only is None else given.only.split(",")
    if unknown := set(chosen) - set(parts):
        parser.error(f"--only: expected some of {', '.join(parts)}; got {', '.join(sorted(unknown))}")
    place, failed = where(), []
    for name in chosen:
        begin = time.perf_counter()
        try:
            found = parts[name]()
        except (subprocess.CalledProcessError, OSError, ValueError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            failed.append(name)
            continue
        if found is not None:
            save(given.results / f"{name}.json", found)
        print(f"{name}: {time.perf_counter() - begin:.0f} s{'' if found else ', left out'}", flush=True)
    save(given.results / "bench.json", {**place, "measured": chosen, "failed": failed})
    return 1 if failed else 0


def save(path: Path, figures: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
