"""Ctrl-C while modules are being loaded."""

from __future__ import annotations

import importlib
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hand.hand_fakes import FakeHand

from skincal.cli.interrupt import REQUESTS, Ended, interruptible, moving, resumable
from skincal.errors import InputError
from skincal.hand.errors import HandError
from skincal.hand.guard import GuardedHand

HANDLERS = (signal.SIGINT, signal.SIGALRM, *REQUESTS)


def test_an_interrupt_waits_until_a_module_is_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = [signal.getsignal(number) for number in HANDLERS]
    text = "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nloaded = True\n"
    (tmp_path / "interrupted_import.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt), interruptible():
        importlib.import_module("interrupted_import")
        time.sleep(5)
    assert sys.modules["interrupted_import"].loaded
    assert [signal.getsignal(number) for number in HANDLERS] == before


def test_what_a_library_makes_of_an_interrupt_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    """NumPy says that arrays cannot be compared where an interrupt comes while it compares them."""
    with pytest.raises(Ended) as ended, interruptible(), resumable(lambda: "Half of it is saved."):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise TypeError("cannot compare") from None
    assert ended.value.code == 130
    assert capsys.readouterr().err == "skincal: interrupted. Half of it is saved.\n"


@contextmanager
def handled(number: int, handler: Any) -> Iterator[None]:
    """Have a signal handled so meanwhile, and check that it is afterwards."""
    before = signal.signal(number, handler)
    try:
        yield
        assert signal.getsignal(number) is handler
    finally:
        signal.signal(number, before)


def test_an_interrupt_that_somebody_else_handles_is_left_to_them() -> None:
    with handled(signal.SIGINT, signal.SIG_IGN), interruptible():
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


@pytest.mark.parametrize("number", REQUESTS)
def test_who_asks_to_end_interrupts(number: signal.Signals) -> None:
    # nohup ignores SIGHUP, and what it starts does, too
    with handled(number, signal.SIG_DFL), pytest.raises(KeyboardInterrupt), interruptible():
        signal.raise_signal(number)
        time.sleep(5)


def test_a_terminal_that_may_go_away_may() -> None:
    with handled(signal.SIGHUP, signal.SIG_IGN), interruptible():
        signal.raise_signal(signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGQUIT])
def test_background_of_a_script_keeps_no_hand_moving(number: int) -> None:
    """A shell without job control has its background commands ignore both."""
    with handled(number, signal.SIG_IGN):
        with pytest.raises(SystemExit) as left, moving():
            signal.raise_signal(number)
        assert left.value.code == 130


def test_an_interrupted_verb_says_so_and_exits_with_130(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("skincal.dataset.read_dataset", interrupt)
    from skincal.cli.main import main

    with pytest.raises(SystemExit) as left:
        main(["fit", str(tmp_path), "--out", str(tmp_path / "cal")])
    assert left.value.code == 130
    assert capsys.readouterr().err.strip() == "skincal: interrupted. Nothing was saved."


def test_second_signal_keeps_the_not_stopped_message(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It may come at any moment: here while the message is composed."""
    from skincal.cli import interrupt

    more, compose = [1, 2], interrupt._danger

    def struck(*given: Any) -> str:
        if more:
            more.pop()
            raise KeyboardInterrupt
        return compose(*given)

    monkeypatch.setattr(interrupt, "_danger", struck)
    with pytest.raises(SystemExit) as left, moving():
        raise HandError("interrupted; stop() did not return! Cut the hand's power.", "driver", stopped=False)
    assert left.value.code == 1
    assert "Cut the hand's power" in capsys.readouterr().err


def test_failed_save_keeps_the_cut_power_message(capsys: pytest.CaptureFixture[str]) -> None:
    def saved() -> str:
        assert "Cut the hand's power" in capsys.readouterr().err, "said before anything is saved"
        raise OSError(28, "No space left on device")

    with pytest.raises(SystemExit) as left, moving(saved):
        raise HandError("stop() did not return! Cut the hand's power.", "driver", stopped=False)
    assert left.value.code == 1
    assert "could not be saved: [Errno 28] No space left on device" in capsys.readouterr().err


@pytest.mark.parametrize("error", [MemoryError(), KeyError("ours"), InputError("no such folder")])
def test_whatever_ends_the_work_tells_that_the_hand_was_stopped(
    error: Exception, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(type(error)), moving(lambda: "Two presses are saved."), GuardedHand(FakeHand()):
        raise error
    assert "ended early. The hand was stopped. Two presses are saved." in capsys.readouterr().err


def test_signals_at_once_are_one_request(monkeypatch: pytest.MonkeyPatch) -> None:
    from skincal.cli import interrupt

    monkeypatch.setattr(interrupt, "_together_s", [0.05])
    with interruptible():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        time.sleep(0.1)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
