"""The guard: whatever a hand or its user does wrong, the hand is stopped in time and the error says what it was."""

from __future__ import annotations

import gc
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hand_fakes import PERIOD_S, FakeHand, changed, tiny_description

from skincal.errors import InputError, WorkError
from skincal.hand.driver import HandCommand, HandState
from skincal.hand.errors import HandError
from skincal.hand.guard import GuardedHand
from skincal.hand.guard_options import GuardOptions

QUICK = GuardOptions(timeout_s=0.15, connect_timeout_s=0.3, stop_timeout_s=0.1, stale_s=0.05, idle_s=5.0)
SLACK_S = 0.25
"""What the machine that runs the tests may be late by."""


def run(
    driver: FakeHand, options: GuardOptions = QUICK, periods: int = 10, **more: Any
) -> tuple[HandError, float]:
    """Moves a hand until it fails. Returns the error, and how long after the first odd call it was stopped [s]."""
    started = time.monotonic()
    with pytest.raises(HandError) as caught, GuardedHand(driver, options, **more) as hand:
        for _ in range(periods):
            started = time.monotonic() if driver.ticks <= driver.after else started
            state = hand.observe()
            hand.act(HandCommand(state.q_desired_rad))
    assert driver.stopped_at is not None
    return caught.value, driver.stopped_at - started


def array(*values: float) -> np.ndarray:
    return np.array(values, dtype=float)


class OddNumber(float):
    """A number that runs code of its own."""

    def __sub__(self, other: float) -> float:
        raise SystemExit(0)

    def __repr__(self) -> str:
        raise KeyboardInterrupt


class OddState:
    """Something that never says what it is."""

    def __repr__(self) -> str:
        time.sleep(30.0)
        return ""


def bad(name: str, kind: str, text: str, **values: Any) -> Any:
    """A case: a state with some values replaced, and the error that it gives."""
    return pytest.param(changed(**values), kind, text, id=name)


BAD_STATES = [
    pytest.param(lambda s: None, "state", "expected a HandState; got NoneType", id="none"),
    pytest.param(lambda s: {"q": 1}, "state", "expected a HandState; got dict", id="dict"),
    pytest.param(lambda s: OddState(), "state", "expected a HandState; got OddState", id="odd state"),
    bad("nan angle", "state", "joint finger: measured angle (q_rad) is nan", q_rad=array(0, np.nan)),
    bad("nan velocity", "state", "joint thumb: measured velocity", dq_rad_per_s=array(np.nan, 0)),
    bad("inf torque", "state", "joint thumb: measured torque (tau_nm) is inf", tau_nm=array(np.inf, 0)),
    bad("nan desired", "state", "desired angle", q_desired_rad=array(np.nan, 0)),
    bad("short", "state", "q_rad: expected an array of float64 of shape (2,); got an array", q_rad=array(0)),
    bad("matrix", "state", "taxels: expected an array of float64 of shape (4,)", taxels=np.zeros((2, 2))),
    bad("list", "state", "tau_nm: expected an array of float64 of shape (2,); got list", tau_nm=[0.0, 0.0]),
    bad("odd list", "state", "got list of 1", q_rad=[OddState()]),
    bad("integers", "state", "got an array of int64", taxels=np.zeros(4, dtype=int)),
    bad("text time", "state", "time_s: expected a number; got str 'now'", time_s="now"),
    bad("odd time", "state", "time_s: expected a number; got OddNumber", time_s=OddNumber(1.0)),
    bad(
        "odd heat", "state", "temperature_c: expected a number; got OddNumber", temperature_c=OddNumber(20.0)
    ),
    bad("no float", "state", "a state that cannot be read: OverflowError", time_s=10**400),
    bad("long double", "state", "time_s: expected a number", time_s=np.longdouble(1)),
    bad("nan time", "clock", "clock says nan", time_s=float("nan")),
    bad("clock back", "clock", "clock went back, from 0.03", time_s=lambda s: s.time_s - 10.5 * PERIOD_S),
    bad("beyond", "joint_limit", "joint finger: measured angle is 1.2 rad, above", q_rad=array(0, 1.2)),
    bad("below", "joint_limit", "joint thumb: measured angle is -1.2 rad, below", q_rad=array(-1.2, 0)),
    bad("fast", "velocity", "is -4.5 rad/s, below the limit of -4 rad/s", dq_rad_per_s=array(-4.5, 0)),
    bad("torque", "torque", "joint finger: measured torque is 1.6 N m, above", tau_nm=array(0, 1.6)),
    bad("inf taxel", "taxels", "taxel (1, 0) is inf", taxels=array(1, 2, np.inf, 3)),
    bad("no stamp", "taxels", "its time stamp is NaN", taxel_time_s=array(*[np.nan] * 4)),
    bad("ahead", "taxels", "taxel (0, 0): its time stamp", taxel_time_s=lambda s: s.taxel_time_s + 0.1),
    bad(
        "one stale",
        "taxels",
        "taxel (1, 1) is stale: 0.6 s old, the limit is 0.5 s",
        taxel_time_s=lambda s: s.taxel_time_s - array(0, 0, 0, 0.6),
    ),
]


@pytest.mark.parametrize(("odd", "kind", "text"), BAD_STATES)
def test_a_bad_state_stops_the_hand_at_once(odd: Callable[[HandState], Any], kind: str, text: str) -> None:
    driver = FakeHand(odd)
    error, after_s = run(driver)
    assert error.kind == kind
    assert text in str(error)
    assert str(error).startswith("fake: ")
    assert "The hand was stopped." in str(error)
    assert error.stopped is True
    assert after_s < SLACK_S
    # Nothing was sent on the strength of a bad state.
    assert len(driver.commands) == driver.after


def test_the_error_carries_joint_value_and_limit() -> None:
    error, _ = run(FakeHand(changed(tau_nm=array(0, -1.6))))
    assert (error.joint, error.value, error.limit) == ("finger", -1.6, -1.5)
    assert isinstance(error, WorkError)
    assert error.exit_status == 1


def test_a_stopped_clock_stops_the_hand_in_time() -> None:
    driver = FakeHand(changed(time_s=0.03, taxel_time_s=np.full(4, 0.03)), pace_s=0.005)
    error, after_s = run(driver, periods=100)
    assert error.kind == "clock"
    assert "the hand's clock has stood at 0.030000 s" in str(error)
    assert after_s < QUICK.stale_s + 0.005 + SLACK_S
    assert driver.ticks > driver.after + 2  # a state may come twice


def test_states_that_fall_behind_a_real_clock_are_stale() -> None:
    options = GuardOptions(lag_s=0.05, idle_s=None)
    # The clock advances by a tenth of what really passes: a queue that fills up.
    odd = changed(
        time_s=lambda s: 0.03 + (s.time_s - 0.03) * 0.1,
        taxel_time_s=lambda s: 0.03 + (s.taxel_time_s - 0.03) * 0.1,
    )
    driver = FakeHand(odd, pace_s=PERIOD_S, real_time=True)
    error, after_s = run(driver, options, periods=100)
    assert error.kind == "clock"
    assert "late, the limit is 0.05 s" in str(error)
    assert after_s < 0.05 / 0.9 + 2 * PERIOD_S + SLACK_S


def test_a_dead_taxel_is_no_reason_to_stop_but_a_dead_sensor_is() -> None:
    nan = float("nan")
    driver = FakeHand(
        changed(taxels=array(nan, 1, 2, 3), taxel_time_s=lambda s: s.taxel_time_s + array(nan, 0, 0, 0))
    )
    with GuardedHand(driver, QUICK) as hand:
        for _ in range(100):
            hand.observe()
    driver = FakeHand(changed(taxels=np.full(4, nan), taxel_time_s=np.full(4, nan)))
    error, _ = run(driver, periods=200)
    assert error.kind == "taxels"
    assert "no taxel has responded for 0.51 s" in str(error)


def test_a_force_above_the_limit_stops_the_hand() -> None:
    forces = iter([0.0, 3.0, 7.9, 8.3])
    driver = FakeHand(after=3)
    error, after_s = run(driver, contact_force=lambda state: next(forces))
    assert error.kind == "force"
    assert (error.value, error.limit) == (8.3, 8.0)
    assert "contact force is 8.3 N, above the limit of 8 N" in str(error)
    assert after_s < SLACK_S
    error, _ = run(FakeHand(), GuardOptions(max_force_n=2.0), contact_force=lambda state: -2.5)
    assert error.limit == 2.0


@pytest.mark.parametrize("value", [float("nan"), "nothing", None])
def test_a_force_that_cannot_be_reported_stops_the_hand(value: Any) -> None:
    assert run(FakeHand(), contact_force=lambda state: value)[0].kind == "force"


@pytest.mark.parametrize("what", ["observe", "act"])
def test_a_driver_that_hangs_is_stopped_from_outside(what: str) -> None:
    driver = FakeHand(hang={what: 1.0})
    start = time.monotonic()
    error, after_s = run(driver)
    assert error.kind == "timeout"
    assert f"{what}() did not return within 0.15 s. The hand was stopped." in str(error)
    assert QUICK.timeout_s <= after_s < QUICK.timeout_s + SLACK_S
    assert driver.threads["stop"] != driver.threads["observe"]
    assert time.monotonic() - start < QUICK.timeout_s + QUICK.stop_timeout_s + 2 * SLACK_S


def test_a_hand_that_does_not_connect_is_stopped_and_closed() -> None:
    driver = FakeHand(raises={"connect": OSError("no such port")})
    error, _ = run(driver)
    assert error.kind == "driver"
    assert "connect() raised OSError: no such port" in str(error)
    assert driver.calls == ["connect", "stop", "close"]
    assert run(FakeHand(hang={"connect": 1.0}, real_time=True))[0].kind == "timeout"


class Undescribed(FakeHand):
    """A hand of which an attribute hangs, raises, or changes."""

    period: Callable[[], Any]

    @property
    def period_s(self) -> float:
        return self.period()


@pytest.mark.parametrize(
    ("period", "text"),
    [
        (lambda: time.sleep(1.0), "description() did not return within 0.15 s"),
        (lambda: sys.exit(0), "description() raised SystemExit"),
        (lambda: "often", "description() raised TypeError"),
        (lambda: float("nan"), "period_s: expected a time above 0 s"),
    ],
)
def test_a_hand_that_cannot_be_described_is_stopped(period: Callable[[], Any], text: str) -> None:
    driver = Undescribed()
    driver.period = period
    error, _ = run(driver)
    assert text in str(error) and error.stopped
    assert "stop" in driver.calls


def test_a_simulated_hand_may_take_longer_to_connect() -> None:
    """The skin model may be compiled first, on a busy computer."""
    options = replace(QUICK, connect_timeout_s=0.05)
    with GuardedHand(FakeHand(hang={"connect": 2 * options.connect_timeout_s}), options) as hand:
        hand.observe()


def test_a_stop_that_hangs_is_left_and_reported() -> None:
    start = time.monotonic()
    error, after_s = run(FakeHand(raises={"observe": ValueError("x")}, hang={"stop": 2.0}))
    assert "stop() did not return within 0.1 s! Cut the hand's power." in str(error)
    assert error.stopped is False
    assert after_s < SLACK_S
    assert time.monotonic() - start < 2 * QUICK.stop_timeout_s + 2 * SLACK_S


def test_an_end_without_error_tells_of_a_stop_that_fails() -> None:
    with (
        pytest.raises(HandError, match="stop\\(\\) failed"),
        GuardedHand(FakeHand(raises={"stop": OSError("x")})),
    ):
        pass


def test_an_error_of_the_user_stops_the_hand_and_goes_on() -> None:
    driver = FakeHand()
    with pytest.raises(KeyError), GuardedHand(driver) as hand:
        hand.observe()
        raise KeyError("mine")
    assert driver.calls[-2:] == ["stop", "close"]


@pytest.mark.parametrize("where", ["in a call", "between calls"])
def test_control_c_stops_the_hand(where: str) -> None:
    driver = FakeHand(hang={"observe": 0.4} if where == "in a call" else {})
    main = threading.main_thread().ident
    assert main is not None
    pressed: list[float] = []

    def press() -> None:
        time.sleep(0.1)
        pressed.append(time.monotonic())
        signal.pthread_kill(main, signal.SIGINT)

    with pytest.raises(KeyboardInterrupt), GuardedHand(driver) as hand:
        threading.Thread(target=press).start()
        while True:
            hand.observe()
            if where == "between calls" and driver.ticks > 5:
                time.sleep(1.0)
    assert driver.stopped_at is not None
    assert 0 <= driver.stopped_at - pressed[0] < SLACK_S


BAD_COMMANDS: dict[str, tuple[Any, str]] = {
    "array": (np.zeros(2), "expected a HandCommand; got an array of float64"),
    "list": (HandCommand([0.0, 0.0]), "expected an array of float64 of shape (2,); got list"),  # type: ignore[arg-type]
    "long": (HandCommand(np.zeros(3)), "expected an array of float64 of shape (2,)"),
    "nan": (HandCommand(array(0, np.nan)), "joint finger: commanded angle is nan"),
    "inf": (HandCommand(array(-np.inf, 0)), "joint thumb: commanded angle is -inf"),
    "outside": (
        HandCommand(array(1.01, 0)),
        "joint thumb: commanded angle 1.01 rad lies outside its limits [-1, 1]",
    ),
    "leap": (HandCommand(array(0, 0.0201)), "joint finger: commanded angle steps by 0.0201 rad; at 2 rad/s"),
}


@pytest.mark.parametrize(("command", "text"), BAD_COMMANDS.values(), ids=BAD_COMMANDS)
def test_a_bad_command_is_not_sent_and_stops_the_hand(command: Any, text: str) -> None:
    driver = FakeHand()
    with pytest.raises(HandError) as caught, GuardedHand(driver) as hand:
        hand.observe()
        start = time.monotonic()
        hand.act(command)
    assert caught.value.kind == "command"
    assert text in str(caught.value)
    assert "The hand was stopped. The command was not sent." in str(caught.value)
    assert driver.commands == []
    assert driver.stopped_at is not None
    assert driver.stopped_at - start < SLACK_S


def test_a_second_command_in_a_period_earns_no_step() -> None:
    driver = FakeHand()
    with (
        pytest.raises(HandError, match=r"steps by 0\.015 rad; .* 0 ms since the last"),
        GuardedHand(driver) as hand,
    ):
        for k in range(4):
            hand.observe()
            hand.act(HandCommand(array(0.02 * k, 0)))
        hand.observe()
        hand.act(HandCommand(array(0.075, 0)))
        hand.act(HandCommand(array(0.09, 0)))
    assert len(driver.commands) == 5


def test_the_nearest_command_is_allowed() -> None:
    driver = FakeHand()
    with GuardedHand(driver) as hand:
        hand.observe()
        for _ in range(80):
            hand.act(hand.nearest(array(5.0, -0.01)))
            hand.observe()
    np.testing.assert_allclose(driver.commands[:2], [[0, 0], [0.02, -0.01]])
    np.testing.assert_allclose(driver.commands[-1], [1.0, -0.01])


def test_an_array_that_is_used_again_does_not_deceive_the_guard() -> None:
    q = np.zeros(2)
    with pytest.raises(HandError, match=r"steps by 0\.5"), GuardedHand(FakeHand()) as hand:
        for _ in range(2):
            hand.observe()
            hand.act(HandCommand(q))
        q += 0.5
        hand.observe()
        hand.act(HandCommand(q))


class FewArrays(FakeHand):
    """Fills the same arrays in every period, and converts commands in place, as drivers in C do."""

    def connect(self) -> None:
        self.kept: HandState | None = None
        super().connect()

    def observe(self) -> HandState:
        state = super().observe()
        self.kept = self.kept or state
        for name in ("q_rad", "q_desired_rad", "taxel_time_s"):
            getattr(self.kept, name)[:] = getattr(state, name)
        return replace(self.kept, time_s=state.time_s)

    def act(self, command: HandCommand) -> None:
        super().act(command)
        command.q_desired_rad[:] = 99.0


def test_what_a_driver_does_with_its_arrays_changes_nothing() -> None:
    with GuardedHand(FewArrays()) as hand:
        seen = []
        for _ in range(5):
            seen.append(hand.observe())
            command = hand.nearest(array(0.5, 0.5))
            hand.act(command)
            assert command.q_desired_rad.max() < 0.2
    assert [float(state.taxel_time_s[0]) for state in seen] == [state.time_s for state in seen]
    assert [float(state.q_rad[0]) for state in seen] == pytest.approx([0.0, 0.0, 0.02, 0.04, 0.06])


def test_a_hand_that_nobody_calls_is_stopped() -> None:
    driver = FakeHand()
    with pytest.raises(HandError, match=r"no call for 0\.1 s\. The hand was stopped") as caught:  # noqa: SIM117
        with GuardedHand(driver, GuardOptions(idle_s=0.1)) as hand:
            hand.observe()
            start = time.monotonic()
            time.sleep(0.3)
            assert driver.stopped_at is not None
            assert driver.stopped_at - start < 0.1 + SLACK_S
            hand.act(HandCommand(np.zeros(2)))
    assert caught.value.kind == "idle"
    assert driver.commands == []


def test_order_of_calls() -> None:
    hand = GuardedHand(FakeHand())
    with pytest.raises(HandError, match="not connected") as caught:
        hand.observe()
    assert caught.value.kind == "order"
    with hand:
        with pytest.raises(HandError, match="observe a state before"):
            hand.act(HandCommand(np.zeros(2)))
        hand.observe()
        hand.stop()
        hand.stop()
        hand.observe()
        with pytest.raises(HandError, match="has been stopped") as caught:
            hand.act(HandCommand(np.zeros(2)))
        assert caught.value.kind == "stopped"
    hand.close()
    with pytest.raises(HandError, match="not connected"):
        hand.observe()
    with pytest.raises(HandError, match="connects only once"):
        hand.connect()


def test_after_a_failure_every_call_says_the_same() -> None:
    driver = FakeHand(changed(q_rad=array(0, np.nan)), after=0)
    hand = GuardedHand(driver)
    hand.connect()
    with pytest.raises(HandError, match="joint finger"):
        hand.observe()
    for call in (hand.observe, lambda: hand.act(HandCommand(np.zeros(2)))):
        with pytest.raises(HandError, match="joint finger") as caught:
            call()
        assert caught.value.kind == "state"
    assert hand.failure is not None
    assert driver.calls.count("observe") == 1
    hand.close()


def test_stop_comes_from_another_thread_while_a_call_waits() -> None:
    driver = FakeHand(hang={"observe": 0.4}, after=0)
    with GuardedHand(driver) as hand:
        timer = threading.Timer(0.05, hand.stop)
        start = time.monotonic()
        timer.start()
        hand.observe()
        assert driver.stopped_at is not None
        assert driver.stopped_at - start < 0.05 + SLACK_S
        timer.join(10.0)


def test_all_calls_but_stop_come_from_one_thread() -> None:
    driver = FakeHand()
    with GuardedHand(driver) as hand:
        hand.act(HandCommand(hand.observe().q_desired_rad))
    assert len({driver.threads[c] for c in ("connect", "observe", "act", "close")}) == 1


def test_no_thread_is_left() -> None:
    before = threading.active_count()
    for _ in range(5):
        with GuardedHand(FakeHand()) as hand:
            hand.observe()
    time.sleep(0.05)
    assert threading.active_count() <= before


def test_options_are_checked() -> None:
    with pytest.raises(
        InputError, match=r"GuardOptions\.timeout_s: expected a finite number above zero; got 0"
    ):
        GuardOptions(timeout_s=0)
    with pytest.raises(InputError, match="stale_s"):
        GuardOptions(stale_s=None)  # type: ignore[arg-type]
    assert GuardOptions(idle_s=None).idle_s is None


def test_a_cycle_costs_little() -> None:
    cycles = 1000
    costs: list[float] = []
    for _ in range(3):
        with GuardedHand(FakeHand(), GuardOptions(timeout_s=5.0)) as hand:
            start = time.process_time()
            for _ in range(cycles):
                hand.act(HandCommand(hand.observe().q_desired_rad))
            guarded = time.process_time() - start
        bare = FakeHand()
        bare.connect()
        start = time.process_time()
        for _ in range(cycles):
            bare.act(HandCommand(bare.observe().q_desired_rad))
        costs.append((guarded - (time.process_time() - start)) / cycles / 2)
    # Below 100 us a call on a quiet machine; the bound leaves room for a busy one.
    assert min(costs) < 400e-6
    print(f"guard: {min(costs) * 1e6:.0f} us a call")


class TextlessError(Exception):
    """Raises when it is asked for its text."""

    def __str__(self) -> str:
        raise RuntimeError

    __repr__ = __str__


class BareHandError(HandError):
    """Of a driver that calls no ``__init__`` of ours, and keeps values of its own."""

    def __init__(self) -> None:
        self.value, self.limit, self.joint = "much", object(), TextlessError()  # type: ignore[assignment]


class HangingTextError(Exception):
    """Does not return when it is asked for its text."""

    def __str__(self) -> str:
        time.sleep(1.0)
        return ""


FOREIGN: dict[str, tuple[BaseException, str]] = {
    "ordinary": (ValueError("bus 3"), "raised ValueError: bus 3"),
    "lost": (ConnectionResetError("gone"), "raised ConnectionResetError: gone"),
    "exit": (SystemExit(3), "raised SystemExit: 3"),
    "no text": (TextlessError(), "raised TextlessError: an error whose text cannot be read"),
    "megabytes": (ValueError("x" * 10**7), "xxx…"),
    "control characters": (ValueError("\x1b[2J"), "raised ValueError: \\x1b[2J"),
    "group": (ExceptionGroup("tasks", [OSError("cable")]), "raised ExceptionGroup: tasks: OSError: cable"),
    "bare error": (BareHandError(), "fake: BareHandError"),
    "base": (GeneratorExit(), "raised GeneratorExit"),
}


@pytest.mark.parametrize("call", ["observe", "act", "connect", "close"])
@pytest.mark.parametrize(("raised", "text"), FOREIGN.values(), ids=FOREIGN)
def test_any_exception_of_a_driver_is_reported(call: str, raised: BaseException, text: str) -> None:
    driver = FakeHand(raises={call: raised}, after=0)
    with pytest.raises(HandError) as caught, GuardedHand(driver, QUICK) as hand:
        for _ in range(3):
            hand.act(HandCommand(hand.observe().q_desired_rad))
    error = caught.value
    assert text in str(error)
    assert len(str(error)) < 400
    assert driver.stopped_at is not None
    if call != "close":
        assert 0 <= driver.stopped_at - driver.raised_at < SLACK_S
        assert f"{text}. The hand was stopped" in str(error)
        assert error.stopped is True
        assert error.__cause__ is raised
        assert error.kind == ("lost" if isinstance(raised, ConnectionError) else "driver")


@pytest.mark.parametrize(("raised", "text"), FOREIGN.values(), ids=FOREIGN)
def test_any_exception_of_stop_tells_to_cut_the_power(raised: BaseException, text: str) -> None:
    driver = FakeHand(raises={"stop": raised, "act": OSError("bus")}, after=0)
    with pytest.raises(HandError, match="Cut the hand's power") as caught, GuardedHand(driver, QUICK) as hand:
        hand.act(HandCommand(hand.observe().q_desired_rad))
    assert text.removeprefix("raised ").removeprefix("fake: ") in str(caught.value)
    assert "The hand was stopped" not in str(caught.value)
    assert caught.value.stopped is False
    assert driver.calls.count("stop") >= 2  # it is tried once more
    assert driver.calls[-1] == "close"


@pytest.mark.parametrize("call", ["observe", "stop"])
def test_a_text_that_hangs_is_a_call_that_hangs(call: str) -> None:
    driver = FakeHand(raises={call: HangingTextError(), "act": OSError("bus")}, after=0)
    started = time.monotonic()
    with (
        pytest.raises(HandError, match=rf"{call}\(\) did not return") as caught,
        GuardedHand(driver, QUICK) as hand,
    ):
        hand.act(HandCommand(hand.observe().q_desired_rad))
    assert caught.value.stopped is (call != "stop")
    assert time.monotonic() - started < 0.9


@pytest.mark.parametrize("time_to_freeze", [3, 40])
def test_frozen_states_with_new_stamps_stop_the_hand(time_to_freeze: int) -> None:
    """Old values hide angles, torques and forces from every other check."""
    kept: list[HandState] = []

    def frozen(state: HandState) -> HandState:
        kept.append(state)
        return replace(kept[0], time_s=state.time_s, taxel_time_s=state.taxel_time_s)

    driver = FakeHand(frozen, after=time_to_freeze)
    with pytest.raises(HandError, match="the states are frozen") as caught, GuardedHand(driver) as hand:
        for _ in range(200):
            hand.observe()
            hand.act(hand.nearest(np.ones(2)))
    assert caught.value.kind == "state"
    assert driver.stopped_at is not None
    assert (driver.ticks - time_to_freeze) * PERIOD_S == pytest.approx(0.5, abs=3 * PERIOD_S)


def test_one_frozen_angle_stops_the_hand() -> None:
    """Though torques and all other angles live."""

    def frozen(state: HandState) -> HandState:
        return replace(
            state, q_rad=array(state.q_rad[0], 0.1), tau_nm=array(0.0, 0.01 * np.sin(state.time_s))
        )

    driver = FakeHand(frozen)
    with (
        pytest.raises(HandError, match=r"joint finger: .* the states are frozen"),
        GuardedHand(driver) as hand,
    ):
        for k in range(300):
            hand.observe()
            hand.act(hand.nearest(np.full(2, np.sin(0.02 * k))))
    assert driver.ticks * PERIOD_S == pytest.approx(0.5, abs=0.15)


def test_a_blocked_or_sticking_joint_is_not_frozen() -> None:
    """The way of its command becomes torque, or is that of friction."""

    def blocked(state: HandState) -> HandState:
        q = state.q_desired_rad
        return replace(state, q_rad=array(0.0, q[1]), tau_nm=array(5.0 * q[0], 1e-3 * state.time_s))

    def sticking(state: HandState) -> HandState:
        return replace(state, q_rad=array(0.1, state.q_rad[1]))

    for odd, target in ((blocked, array(0.2, 0.1)), (sticking, array(0.06, 0.1))):
        with GuardedHand(FakeHand(odd)) as hand:
            for k in range(200):
                hand.observe()
                hand.act(hand.nearest(target * (1 + 0.1 * np.sin(k))))


def test_a_hand_at_rest_may_answer_late() -> None:
    """The time counts from the command on, not from the last new value."""
    past: list[HandState] = []

    def late(state: HandState) -> HandState:
        past.append(state)
        return replace(state, q_rad=past[max(len(past) - 20, 0)].q_rad)

    with GuardedHand(FakeHand(late)) as hand:
        for k in range(300):
            hand.observe()
            hand.act(hand.nearest(np.full(2, 0.5 if k > 150 else 0.0)))


def test_a_hand_at_rest_may_give_the_same_values_for_long() -> None:
    with GuardedHand(FakeHand()) as hand:
        for _ in range(200):
            hand.act(HandCommand(hand.observe().q_desired_rad))
        hand.observe()
        hand.act(hand.nearest(np.ones(2)))


@pytest.mark.parametrize(
    "odd",
    [{"temperature_c": value} for value in (10**400, 1e300, float("inf"), -300.0)]
    + [{"taxels": array(1, 2, 3, 1e300)}],
    ids=["no float", "hot", "inf", "cold", "count"],
)
def test_no_sensor_gives_that(monkeypatch: pytest.MonkeyPatch, odd: dict[str, Any]) -> None:
    """Such a state would be written to a session that cannot be read."""
    meta = tiny_description().meta
    meta = replace(meta, sensor=replace(meta.sensor, value_min=None, value_max=None, integer=False))
    monkeypatch.setattr(
        FakeHand, "description", property(lambda self: replace(tiny_description(), meta=meta))
    )
    error, _ = run(FakeHand(changed(**odd)))
    assert error.kind in ("state", "taxels")


class Watched(FakeHand):
    """A hand that sees an object at a place that a function gives."""

    def __init__(self, place: Callable[[], Any]) -> None:
        super().__init__()
        self.place = place

    def object_position_m(self) -> Any:
        return self.place()


def test_where_an_object_is() -> None:
    place = array(0.001, 0.002)
    with GuardedHand(Watched(lambda: place), QUICK) as hand:
        found = hand.object_position_m()
        place[:] = 1.0
        np.testing.assert_array_equal(found, [0.001, 0.002])
    with GuardedHand(FakeHand(), QUICK) as hand:
        assert np.isnan(hand.object_position_m()).all()


def _never() -> None:
    raise SystemExit(0)


@pytest.mark.parametrize(
    ("place", "text"),
    [
        (lambda: np.zeros((3, 4)), "got an array of float64 of shape"),
        (lambda: array(np.inf, 0.0), "finite or NaN"),
        (lambda: "here", "got str 'here'"),
        (_never, "raised SystemExit"),
        (lambda: time.sleep(5.0), "did not return within 0.15 s"),
    ],
)
def test_an_odd_place_of_an_object_stops_the_hand(place: Callable[[], Any], text: str) -> None:
    driver = Watched(place)
    with pytest.raises(HandError, match="object_position_m") as caught, GuardedHand(driver, QUICK) as hand:
        hand.observe()
        hand.object_position_m()
    assert text in str(caught.value)
    assert "The hand was stopped" in str(caught.value)
    assert driver.stopped_at is not None


def test_a_period_that_changes_is_that_of_the_connection() -> None:
    driver = Undescribed()
    driver.period = lambda: PERIOD_S
    with GuardedHand(driver, QUICK) as hand:
        driver.period = lambda: 0.0
        assert hand.period_s == PERIOD_S


def test_garbage_collections_are_small_while_a_hand_moves() -> None:
    class Node:
        pass

    before = [Node() for _ in range(100)]  # instances of a class are what a collection looks at
    with GuardedHand(FakeHand(), QUICK) as hand:
        hand.observe()
        gc.collect()
        assert not any(type(one) is Node for one in gc.get_objects())
    assert sum(type(one) is Node for one in gc.get_objects()) == len(before)
