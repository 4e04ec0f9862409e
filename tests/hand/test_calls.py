"""The state of a hand after Ctrl-C is known and reported, however often it is pressed."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from hand_fakes import FakeHand

from skincal.hand.calls import STOPPED, Stop
from skincal.hand.errors import HandError
from skincal.hand.guard import GuardedHand
from skincal.hand.guard_options import GuardOptions
from skincal.signals import ENDING, held_back

QUICK = GuardOptions(timeout_s=0.3, connect_timeout_s=0.3, stop_timeout_s=0.1)


def interrupted(driver: FakeHand, options: GuardOptions = QUICK) -> None:
    """A block in which Ctrl-C is pressed."""
    with GuardedHand(driver, options) as hand:
        hand.observe()
        raise KeyboardInterrupt


def press_again(after_s: float, times: int = 1) -> threading.Thread:
    """Sends this process signals in a while."""

    def press() -> None:
        for _ in range(times):
            time.sleep(after_s)
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    thread = threading.Thread(target=press)
    thread.start()
    return thread


def test_an_interrupt_notes_that_the_hand_was_stopped() -> None:
    with pytest.raises(KeyboardInterrupt) as caught:
        interrupted(FakeHand())
    assert caught.value.__notes__ == [STOPPED]


@pytest.mark.parametrize(
    ("driver", "text"),
    [
        (FakeHand(hang={"stop": 0.5}, after=0), "stop() did not return within 0.1 s"),
        (FakeHand(raises={"stop": OSError("bus")}), "stop() failed! OSError: bus"),
        (FakeHand(raises={"stop": SystemExit(0)}), "stop() failed! SystemExit: 0"),
    ],
    ids=["hangs", "raises", "exits"],
)
def test_an_interrupt_does_not_hide_a_stop_that_fails(driver: FakeHand, text: str) -> None:
    with pytest.raises(HandError) as caught:
        interrupted(driver)
    assert str(caught.value).startswith("fake: interrupted; ")
    assert text in str(caught.value)
    assert str(caught.value).endswith("Cut the hand's power.")
    assert caught.value.stopped is False


def test_an_error_of_the_user_does_not_hide_it_either() -> None:
    with (
        pytest.raises(HandError, match=r"mine.*Cut the hand's power"),
        GuardedHand(FakeHand(raises={"stop": OSError("bus")}), QUICK),
    ):
        raise KeyError("mine")


def test_an_interrupt_while_connecting_is_no_different() -> None:
    driver = FakeHand(hang={"connect": 0.25, "stop": 0.5}, after=0)
    thread = press_again(0.05)
    with pytest.raises(HandError, match="Cut the hand's power"):
        GuardedHand(driver, QUICK).connect()
    thread.join(10.0)


def test_a_second_interrupt_waits_until_it_is_known() -> None:
    driver = FakeHand(hang={"observe": 0.4, "stop": 0.4}, after=1)
    thread = press_again(0.1, times=4)
    with pytest.raises(HandError, match=r"stop\(\) did not return within 0\.3 s! Cut"):  # noqa: SIM117
        with GuardedHand(driver, GuardOptions(timeout_s=2.0, stop_timeout_s=0.3)) as hand:
            for _ in range(3):
                hand.observe()
    thread.join(10.0)


def test_what_is_held_back_comes_afterwards() -> None:
    done = False
    with pytest.raises(KeyboardInterrupt), held_back():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        done = True
    assert done
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert {signal.SIGTSTP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGTERM, signal.SIGHUP} <= set(ENDING)
    assert not {signal.SIGKILL, signal.SIGSTOP, signal.SIGCHLD, signal.SIGSEGV} & set(ENDING)


def test_a_signal_between_two_handlers_leaves_none_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Handlers are set one after the other, and a signal may come in between."""
    set_handler, count = signal.signal, 0

    def struck(number: int, handler: Any) -> Any:
        nonlocal count
        count += 1
        if count in (20, len(ENDING) + 10):
            signal.raise_signal(signal.SIGINT)
        return set_handler(number, handler)

    before = {number: signal.getsignal(number) for number in ENDING}
    monkeypatch.setattr(signal, "signal", struck)
    with pytest.raises(KeyboardInterrupt), held_back():
        pass
    monkeypatch.undo()
    assert {number: signal.getsignal(number) for number in ENDING} == before


def test_a_stop_that_raises_once_has_stopped() -> None:
    fails = iter([True, False])

    def stop() -> None:
        if next(fails):
            raise OSError

    assert Stop(stop, 1.0, "fake")() == ""


FORGETFUL = """
import sys
sys.path.insert(0, {folder!r})
from hand_fakes import FakeHand
from skincal.hand.guard import GuardedHand
from skincal.hand.guard_options import GuardOptions
GuardedHand(FakeHand(raises={{"stop": OSError("bus")}}), GuardOptions(stop_timeout_s=0.1)).connect()
"""


def test_a_forgotten_hand_is_reported_without_traceback() -> None:
    script = FORGETFUL.format(folder=str(Path(__file__).parent))
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=30
    )
    assert found.stderr.strip() == "fake: stop() failed! OSError: bus. Cut the hand's power."
