"""Work on a Dask cluster: the same results, a worker that dies, addresses and versions that are wrong."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.coverage_store import finished
from benchmarks.sessions import make_session
from skincal.calibrate import calibrate
from skincal.errors import InputError
from skincal.workers import cluster as cluster_module
from skincal.workers.processes import mapper
from tests.fitting.conftest import QUICK

pytest.importorskip("distributed")


def _dask(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "dask", *arguments]
    # Workers import this module for the functions in it.
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=env, text=True)


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A scheduler and two workers, processes of their own as on a cluster."""
    folder: Path = tmp_path_factory.mktemp("cluster")
    file = folder / "scheduler.json"
    running = [
        _dask(
            "scheduler", "--port", "0", "--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(file)
        )
    ]
    try:
        for _ in range(300):
            if file.exists() and file.stat().st_size:
                break
            time.sleep(0.1)
        running += [
            _dask("worker", "--scheduler-file", str(file), "--nthreads", "1", "--no-dashboard", "--no-nanny",
                  "--local-directory", str(folder))
            for _ in range(2)
        ]  # fmt: skip
        import json

        yield json.loads(file.read_text())["address"]
    finally:
        for process in running:
            process.kill()
            process.wait()


def _die_once(flag: str) -> int:
    """Kill the process that runs this, unless an earlier one has died of it."""
    path = Path(flag)
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def test_results_in_order_and_a_worker_that_dies(scheduler: str, tmp_path: Path) -> None:
    with mapper(scheduler=scheduler) as spread:
        assert list(spread(abs, [-3, -1, 2])) == [3, 1, 2]
        assert list(spread(_die_once, [str(tmp_path / "died")])) != [os.getpid()]
        with pytest.raises(ZeroDivisionError):
            list(spread((1).__truediv__, [0]))


def test_studies_run_on_it(scheduler: str) -> None:
    assert list(finished(abs, [-3, -1, 2], 1, scheduler)) == [3, 1, 2]


@pytest.mark.slow
def test_fit_is_the_same_as_on_this_machine(scheduler: str) -> None:
    session = make_session(np.random.default_rng(5), presses=40)[0]
    here = calibrate(session, options=QUICK, workers=1).calibration
    there = calibrate(session, options=QUICK, scheduler=scheduler).calibration
    assert here.model == there.model
    assert here.draws is not None and there.draws is not None
    assert all(np.array_equal(here.draws[name], there.draws[name]) for name in here.draws)


def test_other_versions_are_refused(scheduler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    own = cluster_module._versions() | {"numpy": "1.0"}
    monkeypatch.setattr(cluster_module, "version", own.get)
    with (
        pytest.raises(InputError, match=r"worker tcp://.*: expected numpy 1.0, as here"),
        mapper(scheduler=scheduler),
    ):
        pass


def test_no_scheduler_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_S", 1)
    with pytest.raises(InputError, match="dask scheduler"), mapper(scheduler="tcp://127.0.0.1:9"):
        pass
    with pytest.raises(InputError, match="address"), mapper(scheduler="nonsense://x"):
        pass
