"""Makes, fits and diagnoses one session, and keeps what was said; the commands run as a user runs them."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

from benchmarks.blind.quick import calibrated, diagnosed
from benchmarks.blind.truth.session import make_session
from benchmarks.blind.truth.spec import Spec
from benchmarks.blind.truth.writing import sealed, write_session
from skincal.calibration import read_calibration
from skincal.cli.terminal import plain

Record = dict[str, Any]

COARSE = (
    *("--arc-step-mm", "1.2", "--y-step-mm", "0.5", "--alpha-step-deg", "5", "--e-count", "12"),
    *("--no-report", "--workers", "1"),
)
"""Options of a fit from fewer starting points; what follows the grid, and so the intervals, is the default's. Sessions
are run side by side, each by one process, and nobody looks at the pages."""
FEWER = ("--min-active", "1")
TAIL = 2000
SKINCAL = (sys.executable, "-m", "skincal")


class RunError(RuntimeError):
    """The test cannot be run."""


@dataclass(frozen=True)
class Done:
    """Exit status and output of a command."""

    status: int
    output: str
    messages: str
    wall_s: float
    cpu_s: float

    def record(self) -> Record:
        """For the result: its JSON, or what it said as it failed."""
        times = {"status": self.status, "wall_s": round(self.wall_s, 2), "cpu_s": round(self.cpu_s, 2)}
        if self.status != 0:
            return times | {"messages": self.messages[-TAIL:]}
        try:
            return times | {"json": json.loads(self.output)}
        except json.JSONDecodeError:
            told = f"expected one JSON object on standard output, got: {self.output[:200]!r}"
            return times | {"status": 1, "messages": told}


@dataclass(frozen=True)
class Bench:
    """Folders and options of a run of the test.

    Attributes:
        out: folder of the test.
        keep: whether datasets and calibrations stay.
        timeout_s: of a command.
        command: what runs skincal.
        extra: options of ``diagnose``.
        stop: set, it ends the commands that run.
        quick: whether sessions are diagnosed in this process, from the engine's own base model.
    """

    out: Path
    keep: bool = False
    timeout_s: float = 3600.0
    command: tuple[str, ...] = SKINCAL
    extra: tuple[str, ...] = ()
    stop: threading.Event = field(default_factory=threading.Event)
    quick: bool = False

    def __reduce__(self) -> tuple[type[Bench], tuple[Any, ...]]:
        """For another process, which is ended by whoever ends its work."""
        return Bench, (self.out.resolve(), self.keep, self.timeout_s, self.command, self.extra)

    def result_file(self, spec: Spec) -> Path:
        """Return the path of a session's result."""
        return self.out / "results" / f"{spec.name}.json"

    def label_file(self, spec: Spec) -> Path:
        """Return the path of a session's sealed label."""
        return self.out / "labels" / f"{spec.name}.sealed"

    def folder(self, spec: Spec) -> Path:
        """For the data of a session; its name tells nothing."""
        word = hashlib.sha256(f"{spec.seed} {spec.name}".encode()).hexdigest()[:10]
        return self.out / "sessions" / word

    def run(self, spec: Spec) -> Record:
        """Makes, fits and diagnoses a session, and keeps the result."""
        folder = self.folder(spec)
        shutil.rmtree(folder, ignore_errors=True)
        start = time.process_time()
        session = make_session(spec)
        write_session(session, folder / "data")
        content, digest = sealed(session.label)
        write_whole(self.label_file(spec), content)
        record: Record = {"session": spec.name, "suite": spec.suite, "label_sha256": digest}
        record["generate_cpu_s"] = round(time.process_time() - start, 2)
        if self.quick:
            record |= diagnosed(folder / "data", plain)
        else:
            record["fit"] = self._fitted(folder).record()
            if record["fit"]["status"] == 0:
                record["diagnose"] = self._diagnosed(folder).record()
                if (folder / "new").exists():
                    record["diagnose"]["calibrated"] = calibrated(read_calibration(folder / "new"))
        write_whole(self.result_file(spec), (json.dumps(record, indent=1) + "\n").encode())
        if not self.keep:
            shutil.rmtree(folder, ignore_errors=True)
        return record

    def _fitted(self, folder: Path) -> Done:
        """The fit; where it refuses and advises to use presses with one active taxel, as it advises."""
        fit = ("fit", str(folder / "data"), "--out", str(folder / "cal"), "--json", *COARSE)
        done = self.skincal(*fit)
        if done.status != 0 and FEWER[0] in done.messages:
            return self.skincal(*fit, *FEWER)
        return done

    def _diagnosed(self, folder: Path) -> Done:
        out = ("--out", str(folder / "new"), "--json", *self.extra)
        return self.skincal("diagnose", str(folder / "data"), str(folder / "cal"), *out)

    def skincal(self, *arguments: str) -> Done:
        """Runs skincal, on one thread of each numerical library."""
        threads = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
        with TemporaryFile() as output, TemporaryFile() as messages:
            start = time.perf_counter()
            process = subprocess.Popen(
                [*self.command, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=messages,
                env={**os.environ, **threads},
            )
            try:
                cpu_s = self._waited(process)
            except BaseException:
                process.terminate()
                process.wait()
                raise
            wall_s = time.perf_counter() - start
            return Done(process.returncode, _content(output), _content(messages), wall_s, cpu_s)

    def _waited(self, process: subprocess.Popen[bytes]) -> float:
        """Processor time of a process and those that it started, once it has ended [s]."""
        limit = time.perf_counter() + self.timeout_s
        while True:
            found, status, usage = os.wait4(process.pid, os.WNOHANG)
            if found:
                process.returncode = os.waitstatus_to_exitcode(status)
                return usage.ru_utime + usage.ru_stime
            if self.stop.is_set():
                raise RunError("stopped")
            if time.perf_counter() > limit:
                process.kill()
            time.sleep(0.05)


def _content(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read().decode(errors="replace")


def write_whole(file: Path, content: bytes) -> None:
    """Writes a file, whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f".{file.name}.part")
    part.write_bytes(content)
    part.replace(file)
