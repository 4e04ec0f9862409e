"""The contract of drivers of a hand, as checks that run against a driver.

A function's name is the check's name, and its docstring the expected behaviour. No check moves a joint by more than
``step_rad``; the hand must be able to move that far without touching anything.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace
from threading import Thread
from typing import Any

import numpy as np

from skincal.errors import SkincalError, quoted, text_of
from skincal.hand.calls import CallTimeoutError, call_and_leave
from skincal.hand.contract import (
    CONNECT_S,
    Check,
    ContractOptions,
    ContractReport,
    FailedCheckError,
    Outcome,
    Progress,
    SkippedCheckError,
    Trial,
    close_directly,
    expect,
    run_checks,
    try_hand,
)
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import HandError
from skincal.robot.description import ARRAYS
from skincal.units import deg


def description_is_sound(trial: Trial) -> str:
    """joints, limits, home and force of the description fit together, before connecting."""
    d = trial.driver.description
    n, limits = len(d.joints), d.limits
    shapes = {one.name: getattr(limits, one.name).shape for one in fields(limits)}
    wrong = [
        f"limits.{name} of shape {shape} for {n} joints" for name, shape in shapes.items() if shape != (n,)
    ]
    if d.home_rad.shape != (n,):
        wrong.append(f"home_rad of shape {d.home_rad.shape} for {n} joints")
    if not wrong and not (limits.lower_rad < limits.upper_rad).all():
        wrong.append("a lower limit that is not below the upper one")
    if not wrong and not ((d.home_rad >= limits.lower_rad) & (d.home_rad <= limits.upper_rad)).all():
        wrong.append("a home outside the joint limits")
    if not ((limits.velocity_rad_per_s > 0).all() and (limits.torque_nm > 0).all() and d.max_force_n > 0):
        wrong.append("a limit of velocity, torque or force that is not above zero")
    expect(not wrong, "; ".join(wrong))
    return f"{n} joints, {d.meta.sensor.taxels} taxels"


def no_state_before_connect(trial: Trial) -> str:
    """observe() before connect() raises an error, and does not hang."""
    try:
        call_and_leave(trial.driver.observe, trial.options.call_s, "observe")
    except CallTimeoutError:
        raise
    except Exception as error:
        return type(error).__name__
    raise FailedCheckError("a state")


def stop_and_close_before_connect(trial: Trial) -> None:
    """stop() and close() may be called before connect(), twice."""
    for _ in range(2):
        trial.time_stop()
        close_directly(trial.driver)


def states_are_sound(trial: Trial) -> str:
    """types, shapes, finite joint values within the limits, taxels finite or NaN, fresh time stamps."""
    trial.connect()
    return f"{len(trial.states(trial.options.periods))} states"


def clock_keeps_the_period(trial: Trial) -> str:
    """period_s is above zero, the hand's clock advances by a period (within half of one) per state, and keeps pace."""
    trial.connect()
    period = trial.period_s
    start = trial.options.clock()
    times = np.array([state.time_s for state in trial.states(trial.options.periods)])
    real_s = (trial.options.clock() - start) / len(times)
    steps = np.diff(times)
    expect(bool((steps > 0).all()), f"a step of {steps.min():.4g} s")
    kept = float((np.abs(steps - period) <= 0.5 * period).mean())
    text = f"{kept:.0%} of the steps within {period:g} s +- 50 % (median {np.median(steps):.4g} s)"
    expect(kept >= 0.95, text)
    pace = float(np.mean(steps)) / real_s
    expect(
        0.5 <= pace <= 1.5 or not trial.driver.real_time,
        f"a clock that runs {pace:.3g} times as fast as ours",
    )
    return f"{text}; {real_s * 1e3:.2g} ms of our time each"


def states_are_not_overwritten(trial: Trial) -> None:
    """A state that was returned does not change when the next one comes."""
    trial.connect()
    first = trial.own_state()
    kept = {name: getattr(first, name).copy() for name in ARRAYS}
    for _ in range(5):
        trial.own_state()
    for name, values in kept.items():
        expect(np.array_equal(getattr(first, name), values, equal_nan=True), f"{name} changed")


def connecting_does_not_move(trial: Trial) -> str:
    """After connect() the hand holds its present angles."""
    trial.connect()
    q = np.array([state.q_rad for state in trial.states(trial.options.periods)])
    half = len(q) // 2
    moved = float(np.abs(np.median(q[half:], axis=0) - np.median(q[:half], axis=0)).max())
    if not trial.driver.follows_commands:
        raise SkippedCheckError("the driver says that it follows no commands: what it plays may move")
    expect(moved <= trial.options.step_rad, f"a joint that moved by {moved:.3g} rad")
    return f"at most {moved:.2g} rad"


def commands_are_followed(trial: Trial) -> str:
    """Each joint in turn makes a small step and returns; desired and measured angles follow."""
    if not trial.options.move:
        raise SkippedCheckError("the hand is not to be moved, or could not be stopped before")
    if not trial.driver.follows_commands:
        raise SkippedCheckError("the driver says that it follows no commands")
    step = trial.options.step_rad
    with trial:
        joints, limits = trial.description.joints, trial.description.limits
        start = trial.observe().q_desired_rad.copy()
        moved: list[float] = []
        for j, name in enumerate(joints):
            goal = start.copy()
            # Towards the middle of its range, where there is room.
            goal[j] += math.copysign(step, 0.5 * (limits.lower_rad[j] + limits.upper_rad[j]) - start[j])
            before = _go(trial, start, 10).q_rad[j]
            after = _go(trial, goal, trial.options.periods)
            missing = abs(float(after.q_desired_rad[j] - goal[j]))
            expect(missing <= 0.1 * step, f"joint {name}: desired angle {missing:.3g} rad from the command")
            share = float((after.q_rad[j] - before) / (goal[j] - start[j]))
            # Friction and noise may hide a small step; the wrong way, or much too far, is something else.
            expect(-0.5 <= share <= 2.0, f"joint {name}: moved by {share:.2f} of the step")
            moved.append(share)
            _go(trial, start, 10)
    return f"moved by {min(moved):.2f} to {max(moved):.2f} of {deg(step):g}°"


def acting_does_not_wait(trial: Trial) -> str:
    """act() returns without waiting for the effect of the command: a tenth of a second at most."""
    trial.connect()
    longest = 0.0
    for _ in range(10):
        state = trial.observe()
        start = trial.options.clock()
        trial.act(HandCommand(state.q_desired_rad.copy()))
        longest = max(longest, trial.options.clock() - start)
    expect(longest <= 0.1, f"a call of {longest:.2g} s")
    return f"at most {longest * 1e3:.2g} ms"


def stop_is_quick_and_can_be_repeated(trial: Trial) -> str:
    """stop() returns in time, also a second time, and the hand stays where it is."""
    trial.connect()
    trial.states(5)
    longest = max(trial.time_stop(), trial.time_stop())
    return f"at most {longest * 1e3:.2g} ms"


def a_stopped_hand_stays(trial: Trial) -> str:
    """After stop() no joint moves on by more than the small step, and no torque grows beyond its present size."""
    trial.connect()
    before = np.array([s.tau_nm for s in trial.states(10)])
    trial.time_stop()
    if not trial.driver.follows_commands:
        raise SkippedCheckError("the driver says that it follows no commands: what it plays goes on")
    try:
        states = trial.states(20)
    except HandError as error:
        if not isinstance(error.__cause__, HandError):
            raise  # what the hand gives is wrong
        raise SkippedCheckError(f"a stopped hand gives no states: {text_of(error)}") from None
    q, tau = np.array([s.q_rad for s in states]), np.array([s.tau_nm for s in states])
    moved = float(np.abs(np.median(q[10:], axis=0) - np.median(q[:10], axis=0)).max())
    expect(moved <= trial.options.step_rad, f"a joint that moved by {moved:.3g} rad")
    noise = 4.0 * before.std(axis=0).max() + 0.01
    grown = float((np.abs(np.median(tau[10:], axis=0)) - np.abs(np.median(before, axis=0))).max())
    expect(grown <= noise, f"a torque that grew by {grown:.3g} N m")
    return f"moved by at most {moved:.2g} rad"


def stop_comes_from_another_thread(trial: Trial) -> str:
    """stop() works while another thread observes."""
    trial.connect()
    trial.observe()
    errors: list[BaseException] = []

    def observe() -> None:
        try:
            for _ in range(10):
                trial.driver.observe()
        except SkincalError:
            # A driver may report that it has been stopped.
            return
        except BaseException as error:
            errors.append(error)

    thread = Thread(target=observe, daemon=True)
    thread.start()
    took_s = trial.time_stop()
    thread.join(10 * trial.options.call_s)
    expect(not thread.is_alive(), "an observe() that hangs since")
    expect(not errors, f"{quoted(errors[0])} in observe()" if errors else "")
    return f"{took_s * 1e3:.2g} ms"


def close_can_be_repeated(trial: Trial) -> None:
    """close() may be called twice, and stop() after it."""
    trial.connect()
    trial.observe()
    trial.close()
    close_directly(trial.driver)
    trial.time_stop()


def a_with_block_stops_on_an_error(trial: Trial) -> None:
    """An error in a with block propagates, and stop() and close() are called."""
    driver, calls = trial.driver, list[str]()
    stop, close = driver.stop, driver.close

    def noted(name: str, work: Callable[[], None]) -> Callable[[], None]:
        def call() -> None:
            calls.append(name)
            work()

        return call

    # Patch the object, so that every call of __exit__ is seen.
    driver.stop, driver.close = noted("stop", stop), noted("close", close)

    def block() -> None:
        with driver:
            driver.observe()
            raise KeyError("of the user")

    try:
        call_and_leave(block, 2 * CONNECT_S, "with block")
    except KeyError:
        expect(calls[-2:] == ["stop", "close"], f"calls: {', '.join(calls) or 'none'}")
        return
    finally:
        driver.stop, driver.close = stop, close
    raise FailedCheckError("no error: the with block swallowed it")


def the_hand_can_be_taken_again(trial: Trial) -> None:
    """After close(), another driver connects to the same hand."""
    trial.connect()
    trial.observe()
    trial.close()
    with Trial.of(trial.make, trial.options) as another:
        another.observe()


CHECKS: tuple[Check, ...] = (
    description_is_sound,
    no_state_before_connect,
    stop_and_close_before_connect,
    states_are_sound,
    clock_keeps_the_period,
    states_are_not_overwritten,
    connecting_does_not_move,
    acting_does_not_wait,
    stop_is_quick_and_can_be_repeated,
    a_stopped_hand_stays,
    stop_comes_from_another_thread,
    close_can_be_repeated,
    a_with_block_stops_on_an_error,
    the_hand_can_be_taken_again,
    commands_are_followed,
)
"""The checks in this order: the hand does not move before everything else is known to work."""


def run_contract(
    name: str,
    make: Callable[[], HandDriver],
    options: ContractOptions | None = None,
    progress: Progress = lambda result: None,
) -> ContractReport:
    """Run every check against a driver of a hand."""
    chosen = options or ContractOptions()

    def attempt(check: Check, could_stop: bool) -> Outcome:
        return try_hand(check, make, replace(chosen, move=chosen.move and could_stop))

    return run_checks(name, CHECKS, attempt, progress)


def _go(trial: Trial, goal: np.ndarray[Any, Any], periods: int) -> HandState:
    """Move to a goal for some periods, at the allowed speed; return a state with median angles of the last third."""
    states: list[HandState] = []
    for _ in range(periods):
        states.append(trial.observe())
        trial.act(trial.nearest(goal))
    last = states[-max(3, periods // 3) :]
    return replace(last[-1], q_rad=np.median([s.q_rad for s in last], axis=0))
