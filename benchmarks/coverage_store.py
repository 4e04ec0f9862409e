"""Keeps the finished sessions of a study, so that it can be interrupted, resumed and grown."""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from skincal.workers.processes import mapper

SCHEDULER = "address of a Dask scheduler, whose workers (each started in a checkout) are used instead"
Record = dict[str, Any]
Key = tuple[str, int]
"""Law and index of a session."""


class Store:
    """The sessions that are done, one a line; the first line says which study they belong to.

    Args:
        path: of the file; made with the first session.
        study: what the sessions depend on, besides law and index.

    Raises:
        ValueError: the file holds another study.
    """

    def __init__(self, path: Path, study: Record) -> None:
        self.path, self.records = path, list[Record]()
        # As it comes back from the file: tuples are lists there.
        self._study = json.loads(json.dumps(study))
        if not path.exists():
            return
        whole = path.read_text(encoding="utf-8")
        # A line without its end was cut off when the run was.
        lines = [json.loads(line) for line in whole[: whole.rfind("\n") + 1].splitlines()]
        if lines and lines[0] != self._study:
            raise ValueError(
                f"{path} holds the sessions of another study (seed, version or options); use another --out"
            )
        path.write_text(whole[: whole.rfind("\n") + 1], encoding="utf-8")
        self.records = lines[1:]

    @property
    def done(self) -> set[Key]:
        """The sessions that are kept."""
        return {(r["law"], r["index"]) for r in self.records}

    def add(self, record: Record) -> None:
        """Keeps one more session."""
        with self.path.open("a", encoding="utf-8") as file:
            if file.tell() == 0:
                file.write(json.dumps(self._study) + "\n")
            file.write(json.dumps(record) + "\n")
        self.records.append(record)

    def of(self, keys: Iterable[Key]) -> list[Record]:
        """Records of these sessions, in their order."""
        by_key = {(r["law"], r["index"]): r for r in self.records}
        return [by_key[key] for key in keys]


def finished(
    run: Callable[[Any], Record], jobs: Sequence[Any], workers: int, scheduler: str | None = None
) -> Iterator[Record]:
    """The records of jobs as they are done, each job on one core.

    Args:
        run: of a module that workers can import.
        jobs: what it takes.
        workers: processes of this machine.
        scheduler: address of a Dask scheduler whose workers are used instead, each started in a checkout; None: none.
    """
    if scheduler is not None:
        with mapper(scheduler=scheduler) as spread:
            yield from spread(run, jobs)
        return
    if workers == 1 or len(jobs) < 2:
        yield from map(run, jobs)
        return
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        try:
            for done in as_completed([pool.submit(run, job) for job in jobs]):
                yield done.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
