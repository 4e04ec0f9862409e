"""Fixtures that several parts of the tests share: small sessions in memory and on disk, and practice data."""

# ruff: noqa: E402 - the number of threads is read when numpy is imported
from __future__ import annotations

import os

# As in the processes of the command line. Threads for small matrices wait for each other longer than they compute.
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")

import gc
import json
import pickle
import shutil
import signal
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
import sharing
import typer.main
from commands import Run, RunJson, captured
from published import META, RADIUS_M

from skincal.dataset import Dataset, Frames, Presses, write_dataset
from skincal.imports import bag_source, source_table

# How long an example takes says how busy the machine is.
hypothesis.settings.register_profile("skincal", deadline=None)
hypothesis.settings.load_profile("skincal")

# Each call of the command line builds the commands of all verbs; building them takes longer than reading a line.
typer.main.get_command = cache(typer.main.get_command)

# A shell has what it runs in the background ignore Ctrl-C and Ctrl-\; tests that send them would then wait for ever.
for number, own in ((signal.SIGINT, signal.default_int_handler), (signal.SIGQUIT, signal.SIG_DFL)):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, own)


def pytest_collection_finish() -> None:
    """Leave modules and tests out of garbage collections, which would look through all of them again and again.

    A full collection takes a second or more late in a long run. A guarded hand undoes this when it is closed.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)


@pytest.fixture(scope="session", autouse=True)
def shared_folder_of_workers(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Where the workers of a run find what another has made."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        sharing.folders[:] = [tmp_path_factory.getbasetemp().parent]


def make_session(presses: int = 12, *, frames_per_press: int = 8, seed: int = 1) -> Dataset:
    """A small session like the paper's, with blurred dots for images; 0 frames per press: none at all."""
    generator = np.random.default_rng(seed)
    meta = replace(META, source="made for a test")
    u, v = generator.uniform(-0.006, 0.006, (2, presses))
    beta = u / RADIUS_M
    points = np.column_stack([RADIUS_M * np.sin(beta), 0.0235 + v, RADIUS_M * np.cos(beta)])
    force = generator.uniform(1.0, 4.0, presses)
    r, c = np.divmod(np.arange(16), 4)
    away = (u[:, None] - (c - 1.5) * 0.004) ** 2 + (v[:, None] - (r - 1.5) * 0.004) ** 2
    images = np.clip(60 * force[:, None] * np.exp(-away / 0.0025**2) + 0.4, 0, 255)
    start = 3.0 + 5.0 * np.arange(presses)
    times = {
        name: start + dt
        for name, dt in zip(("t_start_s", "t_hold_s", "t_release_s", "t_end_s"), (0, 1, 3, 4), strict=True)
    }
    columns = {**times, "pose": np.array(["A", "B"], dtype=object)[np.arange(presses) % 2]}
    return Dataset(
        meta,
        Presses(np.arange(presses), points, force, images, columns=columns),
        _frames(points, force, images, start, frames_per_press) if frames_per_press else None,
    )


def _frames(
    points: np.ndarray, force: np.ndarray, images: np.ndarray, start: np.ndarray, steps: int
) -> Frames:
    """Idle, loading, hold and unloading of each press; at least eight steps, so that each phase is there."""
    press = np.repeat(np.arange(len(force)), steps)
    t = np.tile(np.linspace(-1.0, 4.0, steps), len(force))
    phase = np.digitize(t, [-1e-9, 1.0 - 1e-9, 3.0 + 1e-9])
    share = np.select(
        [phase == 0, phase == 1, phase == 2], [0.0, np.clip(t, 0, 1), 1.0], np.clip(4 - t, 0, 1)
    )
    idle = phase == 0
    return Frames(
        press=np.where(idle, -1, press),
        phase=phase,
        time_s=start[press] + t,
        force_n=share * force[press],
        position_m=np.where(idle[:, None], np.nan, points[press]),
        counts=np.rint(share[:, None] * images[press]),
    )


@pytest.fixture
def session() -> Callable[..., Dataset]:
    """Makes small sessions in memory."""
    return make_session


@pytest.fixture(scope="session")
def written_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A good dataset on disk, with frames, for all tests that only read it."""
    path = tmp_path_factory.mktemp("written") / "session"
    write_dataset(make_session(), path, frames_as="csv")
    return path


@pytest.fixture
def folder(tmp_path: Path, written_session: Path) -> Path:
    """A good dataset on disk, with frames."""
    return Path(shutil.copytree(written_session, tmp_path / "session"))


def shared_folder() -> Path | None:
    """Practice and real data, where they are there: beside the project, or where SKINCAL_SHARED says."""
    place = os.environ.get("SKINCAL_SHARED")
    path = Path(place) if place else Path(__file__).parents[2] / "shared"
    return path if path.is_dir() else None


@pytest.fixture
def shared() -> Path:
    """The folder of practice and real data; the test is skipped where there is none."""
    path = shared_folder()
    if path is None:
        pytest.skip("no folder of practice data beside the project")
    return path


def read_here(read: Callable[..., Any], path: Path, *arguments: Any) -> Any:
    """Read as ``apart`` does, and send what it sends."""
    read, path, arguments = pickle.loads(pickle.dumps((read, path, arguments)))
    return pickle.loads(pickle.dumps(read(path, *arguments)))


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read foreign formats in this process; ``test_apart.py`` tests the other one."""
    for module in (bag_source, source_table):
        monkeypatch.setattr(module, "apart", read_here)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs a command; returns its exit status, standard output and standard error."""
    return partial(captured, capsys)


@pytest.fixture
def run_json(run: Run) -> RunJson:
    """Runs a command with ``--json``, which must succeed; returns the object that it prints."""

    def answer(*arguments: object) -> dict[str, Any]:
        status, out, err = run(*arguments, "--json")
        assert status == 0, err
        return json.loads(out)

    return answer
