"""The contract: shipped drivers and good ones pass, each kind of bad one fails the check that is meant for it."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_fakes import FakeHand, Hands, changed, tiny_description
from test_replay import recorded

from benchmarks.remote_cost import Clock
from skincal.hand import contract, remote, replay
from skincal.hand.contract import CheckResult, ContractOptions, ContractReport
from skincal.hand.contract_checks import run_contract
from skincal.hand.driver import HandCommand, HandState
from skincal.hand.errors import HandError
from skincal.hand.registry import create_driver, driver_options
from skincal.hand.remote import RemoteDriver
from skincal.hand.replay import ReplayDriver
from skincal.hand.serve import HandServer
from skincal.robot import HandDescription


def no_force(description: HandDescription) -> Callable[[HandState], float]:
    """The tiny hand has no joints that a force could be told from."""
    return lambda state: 0.0


GOOD = ContractOptions(contact_force=no_force)
QUICK = replace(GOOD, call_s=0.15, stop_s=0.06, periods=20)


def failed(report: ContractReport) -> set[str]:
    return {result.name for result in report.results if result.status == "failed"}


def result_of(name: str, report: ContractReport) -> CheckResult:
    return next(result for result in report.results if result.name == name)


def test_a_good_driver_passes_every_check() -> None:
    told: list[str] = []
    report = run_contract("fake", FakeHand, GOOD, progress=lambda result: told.append(result.name))
    assert report.ok
    assert report.count("passed") == len(report.results) == len(told) >= 15
    assert all(result.expected for result in report.results)


def test_replay_passes_what_applies_to_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "hand_named", lambda hand: tiny_description())
    left_out = ("dq_0", "dq_1")
    place = recorded(tmp_path / "run", left_out, frames=100)
    report = run_contract("replay", lambda: ReplayDriver(place), GOOD)
    assert failed(report) == set()
    skipped = {result.name for result in report.results if result.status == "skipped"}
    assert skipped == {"connecting does not move", "a stopped hand stays", "commands are followed"}


def test_remote_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("zmq")
    monkeypatch.setattr(remote, "hand_named", lambda hand: tiny_description())
    with HandServer(FakeHand, "tcp://127.0.0.1:*") as server:
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            report = run_contract("remote", lambda: RemoteDriver(server.address), GOOD)
        finally:
            server.end()
            thread.join(10.0)
    assert failed(report) == set()
    assert report.count("skipped") == 0


class Careless(FakeHand):
    """Gives states before it is connected."""

    def observe(self) -> HandState:
        self.connected = True
        return super().observe()


class Overwriting(FakeHand):
    """Uses one array for all states."""

    _taxels = np.zeros(4)

    def observe(self) -> HandState:
        self._taxels += 1.0
        return replace(super().observe(), taxels=self._taxels)


class Waiting(FakeHand):
    """Waits for the effect of a command."""

    def act(self, command: HandCommand) -> None:
        time.sleep(0.12 if len(self.commands) < 3 else 0.0)
        super().act(command)


class Deaf(FakeHand):
    """Takes commands and forgets them."""

    def act(self, command: HandCommand) -> None:
        return


class Backwards(FakeHand):
    """Turns the wrong way."""

    def observe(self) -> HandState:
        state = super().observe()
        return replace(state, q_rad=-state.q_rad)


class Drifting(FakeHand):
    """Goes on after it was stopped, and when it is connected."""

    def observe(self) -> HandState:
        state = super().observe()
        return replace(state, q_rad=state.q_rad + 0.004 * self.ticks)


class Stiffening(FakeHand):
    """Pushes harder when it is stopped."""

    def observe(self) -> HandState:
        state = super().observe()
        return state if self.stopped_at is None else replace(state, tau_nm=np.array([0.5, 0.0]))


class Swallowing(FakeHand):
    """Swallows the user's errors."""

    def __exit__(self, *_: Any) -> bool:  # type: ignore[override]
        self.stop()
        self.close()
        return True


class Abandoning(FakeHand):
    """Leaves the hand moving at the end of a block."""

    def __exit__(self, *_: Any) -> None:
        self.close()


class Once(FakeHand):
    """Cannot be connected a second time, whoever asks."""

    taken = False

    def connect(self) -> None:
        if type(self).taken:
            raise RuntimeError("the port is taken")
        type(self).taken = True
        super().connect()

    def stop(self) -> None:
        if "close" in self.calls and self.connected is False and "observe" in self.calls:
            raise RuntimeError("the port is closed")
        super().stop()


def unfit() -> FakeHand:
    class Unfit(FakeHand):
        @property
        def description(self) -> Any:
            return replace(tiny_description(), home_rad=np.array([0.0, 1.5]))

    return Unfit()


BAD: dict[str, tuple[Callable[[], FakeHand], set[str]]] = {
    "careless": (Careless, {"no state before connect"}),
    "overwriting": (Overwriting, {"states are not overwritten"}),
    "waiting": (Waiting, {"acting does not wait"}),
    "deaf": (Deaf, {"commands are followed"}),
    "backwards": (Backwards, {"commands are followed"}),
    "drifting": (Drifting, {"connecting does not move", "a stopped hand stays", "commands are followed"}),
    "stiffening": (Stiffening, {"a stopped hand stays"}),
    "swallowing": (Swallowing, {"a with block stops on an error"}),
    "abandoning": (Abandoning, {"a with block stops on an error"}),
    "unfit": (unfit, {"description is sound"}),
    "nan": (lambda: FakeHand(changed(q_rad=np.array([0, np.nan]))), {"states are sound"}),
    "clock stands": (lambda: FakeHand(changed(time_s=0.03)), {"clock keeps the period"}),
    "clock is fast": (
        lambda: FakeHand(changed(time_s=lambda s: 3 * s.time_s, taxel_time_s=lambda s: 3 * s.taxel_time_s)),
        {"clock keeps the period"},
    ),
    "stamps ahead": (
        lambda: FakeHand(changed(taxel_time_s=lambda s: s.taxel_time_s + 1)),
        {"states are sound"},
    ),
    "stop hangs": (
        lambda: FakeHand(hang={"stop": 0.1}),
        {"stop and close before connect", "stop is quick and can be repeated", "close can be repeated"},
    ),
    "observe hangs": (
        lambda: FakeHand(hang={"observe": 0.2}),
        {"states are sound", "states are not overwritten"},
    ),
    "stop raises": (lambda: FakeHand(raises={"stop": OSError("bus")}), {"stop is quick and can be repeated"}),
    "cannot be made": (lambda: 1 / 0, {"states are sound", "description is sound"}),  # type: ignore[dict-item]
}


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        pytest.param(*case, id=name, marks=[pytest.mark.slow] if name == "observe hangs" else [])
        for name, case in BAD.items()
    ],
)
def test_a_bad_driver_fails_the_check_that_is_meant_for_it(
    make: Callable[[], FakeHand], expected: set[str]
) -> None:
    report = run_contract("bad", make, QUICK)
    assert not report.ok
    assert expected <= failed(report)
    assert all(result.got for result in report.results if result.status == "failed")


def test_a_hand_that_is_not_given_back() -> None:
    Once.taken = False
    report = run_contract("once", Once, QUICK)
    assert {"the hand can be taken again", "states are not overwritten"} <= failed(report)


def test_a_hand_that_shall_not_move_is_not_moved() -> None:
    hands = Hands()
    report = run_contract("fake", hands, replace(GOOD, move=False))
    assert report.ok
    assert {r.name for r in report.results if r.status == "skipped"} == {"commands are followed"}
    assert all(np.array_equal(q, np.zeros(2)) for hand in hands.made for q in hand.commands)


def test_no_joint_moves_further_than_stated() -> None:
    hands = Hands()
    run_contract("fake", hands, replace(GOOD, step_rad=0.015))
    angles = np.concatenate([hand.commands for hand in hands.made if hand.commands])
    assert np.abs(angles).max() == pytest.approx(0.015)


@pytest.mark.parametrize("raised", [SystemExit(0), KeyboardInterrupt(), BaseException("odd")], ids=repr)
def test_a_driver_that_ends_the_process_fails(raised: BaseException) -> None:
    report = run_contract("exits", lambda: FakeHand(raises={"observe": raised}, after=1), QUICK)
    assert {"states are sound", "commands are followed"} <= failed(report)
    assert type(raised).__name__ in result_of("states are sound", report).got

    assert run_contract("exits", lambda: sys.exit(0), QUICK).count("failed") > 10


def test_a_force_above_the_limit_stops_the_hand_in_every_check() -> None:
    hands = Hands(lambda: FakeHand(changed(tau_nm=np.array([0.0, 1.2])), after=15))
    options = replace(QUICK, contact_force=lambda description: lambda state: 10 * float(state.tau_nm.max()))
    report = run_contract("spike", hands, options)
    texts = [result.got for result in report.results if result.status == "failed"]
    assert "commands are followed" in failed(report)
    assert all("contact force is 12 N, above the limit of 8 N" in text for text in texts)
    assert all("The hand was stopped." in text for text in texts)
    assert all(hand.ticks <= 16 for hand in hands.made if hand.ticks > 15 and hand.commands)


def test_a_clock_that_does_not_keep_pace_with_ours() -> None:
    def make() -> FakeHand:
        return FakeHand(real_time=True)  # its states come as fast as they are asked for

    # 0.1 ms a state, however busy the machine is: our clock is read three times for each.
    own = (1e-4 / 3 * reading for reading in count())
    result = result_of(
        "clock keeps the period", run_contract("fast", make, replace(QUICK, clock=lambda: next(own)))
    )
    assert result.status == "failed"
    assert "times as fast as ours" in result.got


def test_an_interrupted_test_says_that_the_hand_was_stopped() -> None:
    def interrupt(result: object) -> None:
        raise AssertionError("not reached")

    class Pressed(FakeHand):
        @property
        def description(self) -> HandDescription:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        run_contract("pressed", Pressed, QUICK, interrupt)
    assert caught.value.__notes__ == ["The hand was stopped."]


def test_a_driver_without_a_name_passes() -> None:
    class Nameless(FakeHand):
        @property
        def name(self) -> str:  # type: ignore[override]
            raise AttributeError("name")

    assert run_contract("nameless", Nameless, GOOD).ok


def test_a_hand_that_does_not_stop_at_the_end_fails_the_check() -> None:
    report = run_contract("on", lambda: FakeHand(hang={"stop": 1.0}, after=0), replace(QUICK, stop_s=0.02))
    sound = result_of("states are sound", report)
    assert sound.status == "failed" and "Cut the hand's power" in sound.got


def test_a_hand_that_cannot_be_stopped_is_not_moved() -> None:
    hands = Hands(lambda: FakeHand(raises={"stop": RuntimeError("no")}))
    moving = result_of("commands are followed", run_contract("on", hands, QUICK))
    assert "could not be stopped before" in moving.got and "Cut the hand's power" in moving.got
    assert all((q == 0).all() for hand in hands.made for q in hand.commands)


def test_an_interrupt_while_the_hand_moves_is_no_failed_check() -> None:
    """Of a hand that cannot be stopped then: who interrupts is told to cut the power, at once."""
    struck: list[FakeHand] = []

    class Struck(FakeHand):
        def act(self, command: HandCommand) -> None:
            super().act(command)
            if command.q_desired_rad.any() and not struck:
                struck.append(self)
                self.raises = {"stop": RuntimeError("no")}
                signal.raise_signal(signal.SIGINT)

    with pytest.raises(HandError, match=r"interrupted; .*Cut the hand's power") as caught:
        run_contract("struck", Struck, QUICK)
    assert caught.value.stopped is False and struck


def test_a_driver_that_is_never_made_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contract, "CONNECT_S", 0.02)

    def hangs() -> FakeHand:
        time.sleep(1.5)
        return FakeHand()

    assert run_contract("hangs", hangs, QUICK).count("failed") > 10


DOCS = Path(__file__).parents[2] / "docs"
"""With a template of a driver, found as a person would name it."""


@pytest.fixture
def in_docs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))


@pytest.mark.usefixtures("in_docs")
def test_the_template_keeps_the_contract(monkeypatch: pytest.MonkeyPatch) -> None:
    import my_hand

    clock = Clock()
    monkeypatch.setattr(my_hand, "time", clock)
    options = ContractOptions(clock=clock.monotonic)
    report = run_contract("my_hand", lambda: create_driver("my_hand:MyHand", rate_hz="100"), options)
    assert [(r.name, r.got) for r in report.results if r.status != "passed"] == []


@pytest.mark.usefixtures("in_docs")
def test_options_of_the_template_have_help() -> None:
    assert all(option.text for option in driver_options("my_hand:MyHand"))
    assert create_driver("my_hand:MyHand", rate_hz="250").period_s == 0.004


def test_the_page_shows_the_template() -> None:
    page = (DOCS / "own_hand.md").read_text(encoding="utf-8")
    assert "```{literalinclude} my_hand.py" in page
