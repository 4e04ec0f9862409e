"""The guard of a stage keeps what that of a hand keeps."""

from __future__ import annotations

import math
import time
from asyncio import CancelledError
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from skincal.errors import InputError
from skincal.hand import GuardedStage, GuardOptions, HandError, StageDescription, StageState
from skincal.hand.stage_checks import run_stage_checks
from skincal.hand.stage_sim import StageSim

QUICK = GuardOptions(timeout_s=0.3, stop_timeout_s=0.1, idle_s=None)
RIG = StageSim().description


class Stage(StageSim):
    """A stage that runs by clocks that are told to it, and can be made to fail."""

    real_time = True

    def __init__(
        self, odd: Callable[[StageState], Any] = lambda state: state, stop: BaseException | None = None
    ):
        super().__init__()
        self.odd, self.raised = odd, stop
        self.own_s = self.rig_s = 1.0
        self.stops = 0
        self.sent: list[tuple[float, float, np.ndarray]] = []

    def observe(self) -> StageState:
        place = self.sent[-1][2] if self.sent else np.array([0.0, 0.0, 0.01])
        return self.odd(StageState(self.rig_s, place.copy(), 0.0, np.full(16, 7.0)))

    def act(self, position_m: np.ndarray) -> None:
        self.sent.append((self.rig_s, self.own_s, position_m.copy()))

    def stop(self) -> None:
        self.stops += 1
        if self.raised is not None:
            raise self.raised

    def guarded(self, options: GuardOptions = QUICK) -> GuardedStage:
        return GuardedStage(self, options, lambda: self.own_s)

    def go_on(self, rig_s: float, own_s: float) -> None:
        self.rig_s, self.own_s = self.rig_s + rig_s, self.own_s + own_s


ODD: dict[str, tuple[Callable[[StageState], Any], str]] = {
    "none": (lambda state: None, "state"),
    "NaN": (lambda state: replace(state, position_m=state.position_m * math.nan), "state"),
    "text": (lambda state: replace(state, force_n="1"), "state"),
    "a complex number": (lambda state: replace(state, time_s=np.complex128(state.time_s)), "state"),
    "no float": (lambda state: replace(state, force_n=10**400), "state"),
    "long doubles": (lambda state: replace(state, taxels=state.taxels.astype(np.longdouble)), "taxels"),
    "a list": (lambda state: replace(state, position_m=[0.0, 0.0, 0.01]), "state"),
    "clock stands": (lambda state: replace(state, time_s=1.01), "clock"),
    "clock jumps": (lambda state: replace(state, time_s=1e6), "clock"),
    "another number of taxels": (lambda state: replace(state, taxels=np.zeros(3)), "taxels"),
    "endless taxels": (lambda state: replace(state, taxels=np.full(16, np.inf)), "taxels"),
    "counts beyond the converter": (lambda state: replace(state, taxels=np.full(16, 1e9)), "taxels"),
    "half a count": (lambda state: replace(state, taxels=np.full(16, 0.5)), "taxels"),
    "force": (lambda state: replace(state, force_n=13.0), "force"),
    "another place": (lambda state: replace(state, position_m=np.array([0.008, 0.0, 0.01])), "velocity"),
    "place": (lambda state: replace(state, position_m=np.array([0.0, 0.0, 0.03])), "joint_limit"),
}


@pytest.mark.parametrize(("odd", "kind"), ODD.values(), ids=ODD)
def test_an_odd_state_stops_the_stage(odd: Callable[[StageState], Any], kind: str) -> None:
    stage = Stage()
    with pytest.raises(HandError, match="The stage was stopped") as caught, stage.guarded() as guarded:
        for _ in range(2):
            stage.go_on(0.01, 0.01)
            guarded.observe()
        stage.odd = odd
        stage.go_on(0.01, 0.01)
        guarded.observe()
    assert caught.value.kind == kind and stage.stops


def test_frozen_states_stop_the_stage() -> None:
    """Old values with new stamps hide the force."""
    stage = Stage(lambda state: replace(state, position_m=np.array([0.0, 0.0, 0.01])))
    with pytest.raises(HandError, match="the states are frozen"), stage.guarded() as guarded:
        for _ in range(200):
            stage.go_on(0.01, 0.01)
            guarded.observe()
            guarded.act(guarded.nearest(np.array([0.0, 0.0, 0.005])))
    assert stage.stops
    assert stage.rig_s == pytest.approx(1.5, abs=0.05)


def test_a_frozen_axis_stops_the_stage() -> None:
    """Though the load cell and the other axes live."""

    def frozen(state: StageState) -> StageState:
        x, y, _ = state.position_m
        return replace(state, position_m=np.array([x, y, 0.01]), force_n=1e-3 * np.sin(state.time_s))

    stage = Stage(frozen)
    with pytest.raises(HandError, match=r"axis z: .* the states are frozen"), stage.guarded() as guarded:
        for _ in range(200):
            stage.go_on(0.01, 0.01)
            guarded.observe()
            guarded.act(guarded.nearest(np.array([0.005, 0.0, 0.005])))
    assert stage.rig_s == pytest.approx(1.5, abs=0.1)


def test_a_taxel_may_be_dead() -> None:
    stage = Stage(lambda state: replace(state, taxels=np.where(np.arange(16) == 3, np.nan, 7.0)))
    with stage.guarded() as guarded:
        guarded.observe()


def test_taxels_that_are_silent_stop_the_stage() -> None:
    stage = Stage(lambda state: replace(state, taxels=np.full(16, math.nan)))
    with pytest.raises(HandError, match="no taxel has responded") as caught, stage.guarded() as guarded:
        for _ in range(100):
            stage.go_on(0.01, 0.01)
            guarded.observe()
    assert caught.value.kind == "taxels"


def test_states_that_come_late_are_noticed() -> None:
    stage = Stage()
    with pytest.raises(HandError, match="late") as caught, stage.guarded() as guarded:
        for _ in range(20):
            guarded.observe()
            stage.go_on(0.01, 0.1)
    assert caught.value.kind == "clock"


@pytest.mark.parametrize(("rig_s", "own_s"), [(0.0005, 1e-5), (0.01, 1e-5), (1e-5, 0.01), (0.01, 0.01)])
def test_no_command_is_faster_than_the_stage(rig_s: float, own_s: float) -> None:
    """However often states come, and whatever their clock says."""
    stage = Stage()
    with stage.guarded() as guarded:
        guarded.observe()
        for _ in range(40):
            stage.go_on(rig_s, own_s)
            guarded.observe()
            guarded.act(guarded.nearest(RIG.lower_m))
    moved = float(np.linalg.norm(stage.sent[-1][2] - [0.0, 0.0, 0.01]))
    assert moved <= RIG.max_speed_m_per_s * 40 * min(rig_s, own_s) * (1 + 1e-6) + 1e-7


def test_random_sequences_keep_the_speed() -> None:
    rng = np.random.default_rng(4)
    for _ in range(100):
        stage = Stage()
        with stage.guarded() as guarded:
            guarded.observe()
            base, rig_s, own_s = np.array([0.0, 0.0, 0.01]), stage.rig_s, stage.own_s
            for _ in range(20):
                try:
                    if rng.random() < 0.6:
                        stage.go_on(*rng.choice([0.0, 1e-4, 0.004, 0.01, 0.02, 0.09], 2))
                        guarded.observe()
                    else:
                        goal = base + rng.uniform(-6e-4, 6e-4, 3)
                        guarded.act(guarded.nearest(goal) if rng.random() < 0.7 else goal)
                except HandError:
                    break
                if stage.sent and not np.array_equal(stage.sent[-1][2], base):
                    sent_rig_s, sent_own_s, place = stage.sent[-1]
                    passed_s = min(sent_rig_s - rig_s, sent_own_s - own_s, stage.period_s)
                    assert np.linalg.norm(place - base) <= RIG.max_speed_m_per_s * passed_s + 1e-8
                    base, rig_s, own_s = place, sent_rig_s, sent_own_s


def test_a_second_command_in_a_period_is_not_sent() -> None:
    stage = Stage()
    with pytest.raises(HandError, match="the time passed") as caught, stage.guarded() as guarded:
        guarded.observe()
        stage.go_on(0.01, 0.01)
        guarded.observe()
        step = np.array([0.0, 0.0, 0.9 * RIG.max_speed_m_per_s * stage.period_s])
        guarded.act(np.array([0.0, 0.0, 0.01]) - step)
        guarded.act(np.array([0.0, 0.0, 0.01]) - 2 * step)
    assert caught.value.kind == "command" and len(stage.sent) == 1


@pytest.mark.parametrize("to_m", [[0.0, 0.0, 0.03], [0.0, 0.0, 0.011], [0.0, np.nan, 0.01]])
def test_a_command_beyond_travel_or_speed_is_not_sent(to_m: list[float]) -> None:
    stage = Stage()
    with pytest.raises(HandError) as caught, stage.guarded() as guarded:
        guarded.observe()
        guarded.act(np.array(to_m))
    assert caught.value.kind == "command" and not stage.sent


def test_after_a_stop_no_command_is_sent() -> None:
    stage = Stage()
    with pytest.raises(HandError, match="has been stopped"), stage.guarded() as guarded:
        guarded.observe()
        guarded.stop()
        guarded.act(np.array([0.0, 0.0, 0.01]))
    assert not stage.sent


def test_a_stage_that_nobody_calls_is_stopped() -> None:
    stage = Stage()
    with stage.guarded(replace(QUICK, idle_s=0.05)) as guarded:
        guarded.observe()
        time.sleep(0.5)
        assert stage.stops
        with pytest.raises(HandError, match="no call for"):
            guarded.observe()


def test_an_interrupt_tells_whether_the_stage_was_stopped() -> None:
    def interrupt(stage: Stage) -> None:
        with stage.guarded() as guarded:
            guarded.observe()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as noted:
        interrupt(Stage())
    assert noted.value.__notes__ == ["The stage was stopped."]
    for trouble in (OSError("bus"), SystemExit(0), KeyboardInterrupt()):
        with pytest.raises(HandError, match="Cut the stage's power") as caught:
            interrupt(Stage(stop=trouble))
        assert caught.value.stopped is False


@pytest.mark.parametrize(
    "change",
    [
        {"max_speed_m_per_s": 5.0}, {"max_speed_m_per_s": math.nan}, {"max_force_n": 1e4}, {"max_force_n": 0.0},
        {"upper_m": np.array([5.0, 1.0, 1.0])}, {"upper_m": np.array([-0.1, 0.1, 0.1])},
    ],
)  # fmt: skip
def test_limits_that_no_bench_has_are_refused(change: dict[str, Any]) -> None:
    class Wild(Stage):
        @property
        def description(self) -> StageDescription:
            return replace(RIG, **change)

    with pytest.raises(InputError, match="stage simulated stage"), Wild().guarded():
        pass


class Fast(StageSim):
    """A stage of a speed that no bench has."""

    @property
    def description(self) -> StageDescription:
        return replace(RIG, max_speed_m_per_s=5.0)


def test_limits_may_be_allowed() -> None:
    with GuardedStage(Fast(), replace(QUICK, beyond_limits=True)) as guarded:
        guarded.observe()


def test_a_driver_that_exits_fails_the_checks() -> None:
    class Exits(StageSim):
        def observe(self) -> StageState:
            raise SystemExit(0)

    def make() -> StageSim:
        raise SystemExit(0)

    def cancelled() -> StageSim:
        raise CancelledError

    for made in (Exits, make, cancelled):
        assert not run_stage_checks("exits", made, move=False).ok


def test_a_driver_that_hangs_fails_the_checks() -> None:
    class Hangs(StageSim):
        closed = False

        def close(self) -> None:
            if self.closed:
                time.sleep(1.5)
            self.closed = True

    def make() -> StageSim:
        time.sleep(1.5)
        return StageSim()

    for made in (Hangs, make):
        report = run_stage_checks("hangs", made, move=False, guard=replace(QUICK, connect_timeout_s=0.1))
        assert next(one for one in report.results if one.name == "stops").status == "failed"


def test_a_stage_that_cannot_be_stopped_is_not_moved() -> None:
    sent: list[np.ndarray] = []

    class Goes(StageSim):
        def act(self, position_m: np.ndarray) -> None:
            sent.append(position_m)

        def stop(self) -> None:
            raise RuntimeError("no")

    found = {one.name: one.status for one in run_stage_checks("goes", Goes, guard=QUICK).results}
    assert found["stops"] == "failed" and found["moves"] == "skipped"
    assert not sent
    assert run_stage_checks("stage-sim", StageSim).ok


def test_checks_allow_limits_that_somebody_allows() -> None:
    assert not run_stage_checks("fast", Fast, move=False).ok
    assert run_stage_checks("fast", Fast, move=False, guard=GuardOptions(beyond_limits=True)).ok
