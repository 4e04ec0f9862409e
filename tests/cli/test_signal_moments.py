"""Signals at every moment of a verb that moves a hand: it is stopped before anything is said, and that is true."""

from __future__ import annotations

import io
import os
import select
import signal
import sys
import time
from collections import Counter
from contextlib import suppress
from types import FrameType
from typing import Any

import numpy as np
import pytest
from hand.hand_fakes import FakeHand
from killing import LONGEST_S, end_of, read_all

from skincal.cli.interrupt import moving
from skincal.cli.main import main
from skincal.errors import SkincalError
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.guard import GuardedHand
from skincal.hand.guard_options import GuardOptions
from skincal.robot import HandDescription, hand_named
from skincal.signals import ENDING, restore

QUICK = GuardOptions(timeout_s=1.0, connect_timeout_s=1.0, stop_timeout_s=0.5)
WATCHED = (
    "skincal/hand/guard_calls",
    "skincal/hand/calls",
    "skincal/signals",
    "skincal/cli/interrupt",
    "/contextlib",
)
HELD = HandCommand(np.zeros(2))
HAND = hand_named()


def press(guarded: GuardedHand) -> None:
    with moving(), guarded as hand:
        hand.observe()
        hand.act(HELD)


def struck(guarded: GuardedHand, at: int) -> int:
    """Presses, with a signal at a line that is run (0: none), loops not to their end; returns the number of lines."""
    count, seen = 0, Counter[tuple[str, int]]()

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal count
        if not any(name in frame.f_code.co_filename for name in WATCHED):
            return None
        place = frame.f_code.co_filename, frame.f_lineno
        seen[place] += 1
        if event == "line" and seen[place] <= 3:
            count += 1
            if count == at:
                signal.raise_signal(signal.SIGINT)
        return trace

    sys.settrace(trace)
    try:
        press(guarded)
    finally:
        sys.settrace(None)
    return count


@pytest.mark.parametrize("every", [7, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("fails", [False, True], ids=["stops", "fails"])
def test_a_signal_at_any_line_stops_the_hand(
    fails: bool, every: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Hands whose stop returns, and hands whose stop fails."""
    before = {number: signal.getsignal(number) for number in ENDING}
    lines = struck(GuardedHand(FakeHand(), QUICK), 0)
    for at in range(1 + fails, lines + 1, every):
        driver = FakeHand(raises={"stop": OSError("bus")} if fails else {})
        guarded = GuardedHand(driver, QUICK)
        with suppress(SystemExit, KeyboardInterrupt, SkincalError):
            struck(guarded, at)
        said, calls = capsys.readouterr().err, driver.calls
        assert "stop" in calls or "connect" not in calls, at
        # Before the first and after the last line of the block nothing is said here.
        if "connect" in calls and said:
            assert ("The hand was stopped." in said) is not fails, (at, lines, said)
            assert ("Cut the hand's power" in said) is fails, (at, lines, said)
        assert said or "close" in calls or "connect" not in calls, at
        restore(dict(before))  # a signal at the end of the block may leave some as they are there
        with suppress(SkincalError):
            guarded.close()


class Told(HandDriver):
    """A hand that follows and writes down what is done to it: connected, moved, stop called, stop returned."""

    name, real_time = "told", False
    log, fails = -1, False

    def __init__(self) -> None:
        self.q, self.ticks, self.connected = self.description.home_rad, 0, False

    @property
    def description(self) -> HandDescription:
        return HAND

    @property
    def period_s(self) -> float:
        return 0.005

    def connect(self) -> None:
        os.write(self.log, b"c")
        self.connected = True

    def observe(self) -> HandState:
        assert self.connected
        time.sleep(self.period_s)
        self.ticks += 1
        q, t = self.q, self.ticks * self.period_s
        return HandState(t, q.copy(), 0 * q, 0 * q, q.copy(), np.zeros(16), np.full(16, t))

    def act(self, command: HandCommand) -> None:
        self.q = command.q_desired_rad
        os.write(self.log, b"a")

    def stop(self) -> None:
        os.write(self.log, b"s")
        time.sleep(0.02)
        if self.fails:
            raise OSError("bus")
        os.write(self.log, b"S")

    def close(self) -> None:
        pass


def begin(fails: bool) -> tuple[int, int, int]:
    """Tests a hand in a process of its own; returns it, its log and its standard error."""
    log, log_end = os.pipe()
    err, err_end = os.pipe()
    process = os.fork()
    if process:
        os.close(log_end)
        os.close(err_end)
        return process, log, err
    status = 70
    try:
        status = _status_of_test(fails, log_end, err_end)
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    except KeyboardInterrupt:
        # After the last word, when the verb has given the signal back to Python: it kills, as all others do then.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.raise_signal(signal.SIGINT)
    finally:
        os._exit(status)


def _status_of_test(fails: bool, log: int, err: int) -> int:
    os.setsid()  # a signal to suspend that comes after the last word would leave it waiting for a shell
    os.dup2(err, 2)
    sys.stderr, sys.stdout = os.fdopen(2, "w", buffering=1), io.StringIO()
    Told.log, Told.fails = log, fails
    sys.modules["told_hand"] = sys.modules[__name__]
    try:
        main(["hand", "test", "told_hand:Told"])
    except SystemExit as ended:
        if sys.stdout.getvalue():
            os.write(log, LATE)
        return ended.code if isinstance(ended.code, int) else 0
    return 70


RUNS = 16
LATE = b"e"
"""The test of the hand came to its end, and reported, before a signal was there."""
STOPPED_TEXT = "skincal: interrupted. The hand was stopped.\n"
KINDS = [signal.SIGTERM, signal.SIGINT, signal.SIGTSTP, signal.SIGQUIT, signal.SIGHUP, signal.SIGUSR1]


def test_signals_at_any_time_leave_no_hand_moving() -> None:
    """The first from 0 to 300 ms after the hand was first called, a second and third from 0 to 300 ms later."""
    runs = [begin(fails=n % 4 == 3) for n in range(RUNS)]
    signals: list[tuple[float, int, int]] = []
    heads = [os.read(log, 1) if select.select([log], [], [], LONGEST_S)[0] else b"" for _, log, _ in runs]
    for n, (process, *_) in enumerate(runs):
        first = 0.3 * n / RUNS
        for later in (0.0, 0.3 * (n % 7) / 7, 0.3 * (n % 5 + n % 7) / 7):
            signals.append((first + later, process, KINDS[(n + len(signals)) % len(KINDS)]))
    begun = time.monotonic()
    for at, process, number in sorted(signals):
        time.sleep(max(0.0, begun + at - time.monotonic()))
        os.kill(process, number)
    interrupted = 0
    for n, ((process, log, err), head) in enumerate(zip(runs, heads, strict=True)):
        done, said = (head + read_all(log, process)).decode(), read_all(err, process).decode()
        status = end_of(process)
        assert "Traceback" not in said and "internal" not in said, said
        if done.endswith(LATE.decode()):
            continue
        interrupted += 1
        if n % 4 == 3:
            assert "Cut the hand's power" in said and "was stopped" not in said, (done, said)
        else:
            assert said == STOPPED_TEXT and "a" not in done[done.rindex("S") :], (n, status, done, said)
        # A signal after the last word kills.
        assert status == (1 if n % 4 == 3 else 130) or status < 0, status
    assert interrupted > RUNS / 2
