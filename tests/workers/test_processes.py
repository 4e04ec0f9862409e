from __future__ import annotations

import gc
import os
import subprocess
import sys
import time

import pytest

from skincal import progress
from skincal.workers.processes import mapper, rare_collections


def _says(_: int) -> tuple[int, bool]:
    time.sleep(0.2)  # so that each process gets one
    return os.getpid(), progress.on_compile is not None


def test_first_process_works_too_and_alone_says_it_compiles(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(progress, "on_compile", lambda: None)
    with mapper(2) as spread:
        ((worker, says),) = spread(_says, [0])  # it has begun
        assert worker != os.getpid() and not says
        assert list(spread(_says, [0, 1])) == [(worker, False), (os.getpid(), True)]


def _fails_at_two(number: int) -> int:
    if number == 2:
        raise ValueError(number)
    return number


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_an_error_is_raised_when_it_is_its_turn(workers: int):
    seen: list[int] = []
    with mapper(workers) as spread, pytest.raises(ValueError, match="2"):
        for found in spread(_fails_at_two, range(6)):
            seen.append(found)  # noqa: PERF402 - what came before the error counts
    assert seen == [0, 1]


def test_workers_start_before_anything_heavy_is_imported() -> None:
    script = (
        "import sys, skincal.workers.processes; print(sorted({'numpy', 'numba', 'scipy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def _thresholds(_: int) -> tuple[int, int, int]:
    return gc.get_threshold()


def test_rare_garbage_collections_in_workers() -> None:
    before = gc.get_threshold()
    with mapper(2) as spread, rare_collections():
        [worker] = spread(_thresholds, [0])
        assert worker == gc.get_threshold() > before
    assert gc.get_threshold() == before
