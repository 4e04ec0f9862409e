"""The contract of drivers of a stage, as checks that run against a driver."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from skincal.hand.calls import call_and_leave
from skincal.hand.contract import (
    Check,
    ContractReport,
    Outcome,
    Progress,
    SkippedCheckError,
    created,
    expect,
    outcome,
    run_checks,
)
from skincal.hand.driver import StageDriver, StageState
from skincal.hand.guard_options import GuardOptions
from skincal.hand.stage_guard import GuardedStage, check_stage

STEP_M, PERIODS, STOP_S = 0.2e-3, 20, 0.5
"""Motion of the tip [m]; number of states that are checked; longest duration of ``stop`` [s]."""


def states(stage: StageDriver, guard: GuardOptions) -> str:
    """Finite states of the right shape, whose clock advances, within travel and force."""
    with GuardedStage(stage, guard) as guarded:
        observed = [guarded.observe() for _ in range(PERIODS)]
    periods = np.diff([state.time_s for state in observed])
    return f"{PERIODS} states, one every {1e3 * float(np.median(periods)):.3g} ms"


def moves(stage: StageDriver, guard: GuardOptions) -> str:
    """The tip makes a commanded step up, and one back."""
    with GuardedStage(stage, guard) as guarded:
        start = guarded.observe().position_m
        rig = stage.description
        high = np.minimum(start + np.array([0.0, 0.0, STEP_M]), rig.upper_m)
        count = int(np.ceil(STEP_M / (0.5 * rig.max_speed_m_per_s * stage.period_s))) + PERIODS
        state = guarded.observe()
        for target in (high, start):
            begin = state.position_m
            for n in range(count):
                share = min(1.0, 2 * (n + 1) / count)
                guarded.act(np.clip(begin + share * (target - begin), rig.lower_m, rig.upper_m))
                state = guarded.observe()
            off = float(np.linalg.norm(state.position_m - target))
            expect(off <= 0.5 * STEP_M, f"the tip is {1e3 * off:.3g} mm from its target")
    return f"{1e3 * STEP_M:g} mm and back"


def stops(stage: StageDriver, guard: GuardOptions) -> str:
    """``stop`` returns at once, twice in a row, and nothing moves afterwards."""
    with GuardedStage(stage, guard) as guarded:
        before = guarded.observe()
        begin = time.monotonic()
        guarded.stop()
        guarded.stop()
        took = time.monotonic() - begin
        after: StageState = [guarded.observe() for _ in range(5)][-1]
    call_and_leave(stage.close, guard.connect_timeout_s, "close again")
    expect(took <= STOP_S, f"stop() took {took:.3g} s")
    moved = float(np.linalg.norm(after.position_m - before.position_m))
    expect(moved <= STEP_M, f"the tip moved on by {1e3 * moved:.3g} mm")
    return f"within {1e3 * took:.3g} ms"


def describes(stage: StageDriver, guard: GuardOptions) -> str:
    """A description with travel, speed and force above zero and no larger than those of a bench, and a flat sensor."""
    rig = stage.description
    check_stage(rig, beyond=guard.beyond_limits)
    kind = rig.meta.surface.kind
    expect(rig.meta.surface.is_plane, f"a surface of kind {kind}; a stage presses along z")
    return f"{rig.name}: never above {rig.max_force_n:g} N and {1e3 * rig.max_speed_m_per_s:g} mm/s"


def run_stage_checks(
    name: str,
    make: Callable[[], StageDriver],
    *,
    move: bool = True,
    guard: GuardOptions | None = None,
    progress: Progress = lambda result: None,
) -> ContractReport:
    """Run every check against a driver of a stage.

    Args:
        name: the driver's name, for the report.
        make: creates a driver that is not connected; called once per check.
        move: whether to move the stage; one that could not be stopped is not moved.
        guard: limits and times.
        progress: callback with every result.
    """
    limits = guard or GuardOptions()

    def attempt(check: Check, could_stop: bool) -> Outcome:
        def run() -> str | None:
            if check is moves and not (move and could_stop):
                raise SkippedCheckError("the stage is not to be moved, or could not be stopped before")
            return check(created(make, limits.connect_timeout_s), limits)

        return outcome(run, limits.connect_timeout_s)

    return run_checks(name, (describes, states, stops, moves), attempt, progress)
