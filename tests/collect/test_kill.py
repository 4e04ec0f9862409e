"""A session that is killed at random moments and started again: nothing finished is lost, and the end is whole."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from commands import Fork

from skincal.collect import Plan, PlannedPress, write_plan
from skincal.dataset import check_dataset

PRESSES = 4
PLAN = Plan(
    "killed",
    tuple(
        PlannedPress(1e-3 * (i % 3 - 1), 1e-3 * (i // 3), 1.0 + 0.3 * i, 0.04, 0.3, pose="A")
        for i in range(PRESSES)
    ),
    {"A": (0.0, 0.25, 0.83)},
)
TIMEOUT_S = 900
"""A process that hangs is given up after this; sessions take seconds, and minutes where many others are at work."""
ASKED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Requests to end that a session answers: it stops the hand and says what is kept."""


class Killed:
    """A session that is killed again and again: a fork of this process, or one that a shell could have started."""

    def __init__(self, folder: Path, *, forked: bool) -> None:
        self.folder, self.out, self.forked = folder, folder / "run", forked
        folder.mkdir()
        write_plan(PLAN, folder / "plan.toml")
        self.kept: dict[str, bytes] = {}

    def start(self, *, die: signal.Signals | None = None, after_s: float = 0.0) -> tuple[int, str]:
        """Runs the command; kills it after a time. Returns its exit status and what it said."""
        command = [
            "collect", "--driver", "sim", "--seed", "5", "--plan", "plan.toml", "--out", "run", "--json",
        ]  # fmt: skip
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(Path(__file__).parents[2])}
        process = (
            Fork(self.folder, command)
            if self.forked
            else subprocess.Popen(
                [sys.executable, "-m", "skincal", *command],
                cwd=self.folder,
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                # A background job ignores Ctrl-C, and so would its children.
                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
            )
        )
        if die is not None:
            deadline = time.monotonic() + TIMEOUT_S
            lock = self.folder / ".run.collect.lock"
            # Before the program has begun, a request to end is the interpreter's own affair. A session of which only
            # the dataset was missing may be over before anybody looks.
            while die in ASKED and not lock.exists() and process.poll() is None:
                assert time.monotonic() < deadline
                time.sleep(0.02)
            time.sleep(after_s)
            process.send_signal(die)
        _, err = process.communicate(timeout=TIMEOUT_S)
        assert process.returncode is not None
        return process.returncode, err

    def look(self) -> None:
        """Every press that was once finished is still there, bit for bit; the output is whole or not there."""
        now = {p.name: p.read_bytes() for p in (self.folder / ".run.collect").glob("press-*.npz")}
        if self.out.exists():
            check = check_dataset(self.out)
            assert check.errors == () and check.dataset is not None and len(check.dataset.presses) == PRESSES
            return
        assert {name: now.get(name) for name in self.kept} == self.kept
        self.kept = now

    def finish(self) -> None:
        """Lets the session end, if it has not; the dataset is whole and valid, and nothing else is left."""
        if not (self.out.exists() and not (self.folder / ".run.collect").exists()):
            status, err = self.start()
            assert status == 0, err
            assert {path.name for path in self.folder.iterdir()} == {"plan.toml", "run"}
        self.look()
        dataset = check_dataset(self.out).dataset
        assert dataset is not None and dataset.frames is not None
        assert dataset.presses.press.tolist() == list(range(PRESSES))
        np.testing.assert_allclose(dataset.presses.force_n, [p.force_n for p in PLAN.presses], atol=0.25)
        assert np.all(np.diff(dataset.frames.time_s) > 0)


def kill_often(folder: Path, kills: int, seed: int, how: signal.Signals, *, forked: bool) -> int:
    """Kills a session at random moments until it has come to its end; returns how often it was killed."""
    rng = np.random.default_rng(seed)
    session = Killed(folder, forked=forked)
    done = 0
    while done < kills and not session.out.exists():
        # Requests are counted from the beginning of the session, the rest from that of the process.
        latest_s = 0.7 if how in ASKED else 1.5 if forked else 4.0
        status, err = session.start(die=how, after_s=float(rng.uniform(0.0, latest_s)))
        assert "Traceback" not in err, err
        if how in ASKED and status != 0 and not session.out.exists():
            assert status == 130, err
        done += status != 0
        session.look()
    session.finish()
    return done


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_a_session_that_is_killed_goes_on(tmp_path: Path, how: signal.Signals):
    # A second kill meets what the first one left. Requests are answered alike (tests/cli/test_interrupt.py).
    # On a busy machine a session may end before anybody gets to kill it.
    assert any(kill_often(tmp_path / str(seed), 2, seed, how, forked=True) for seed in (1, 2, 3))


@pytest.mark.slow
def test_fifty_kills(tmp_path: Path):
    kills = session = 0
    while kills < 50:
        kills += kill_often(tmp_path / str(session), 50 - kills, session, signal.SIGKILL, forked=False)
        session += 1
    assert kills >= 50
