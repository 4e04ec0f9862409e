"""No sequence of states, commands and faults gets a command past the guard that breaks a limit.

What must hold of every command is written down here a second time, from the hand's side: the guard's own checks are
not used.
"""

from __future__ import annotations

import math
import os

import numpy as np
import pytest
from hand_fakes import PERIOD_S, FakeHand, tiny_description
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

from skincal.hand.driver import HandCommand, HandState
from skincal.hand.errors import HandError
from skincal.hand.guard import GuardedHand
from skincal.hand.guard_options import GuardOptions

OPTIONS = GuardOptions(idle_s=None)
LIMITS = tiny_description().limits
LOW, HIGH = LIMITS.lower_rad, LIMITS.upper_rad
FORCE_N = tiny_description().max_force_n
ROUNDING = 1e-8

FAULTS = (
    "angle", "velocity", "torque", "force", "desired", "nan", "none", "old", "counts", "drop", "exit", "copy"
)  # fmt: skip
"""What may be wrong with a state, or come instead of one."""

STEPS_S = (0.0, 1e-4, 0.002, 0.004, 0.02, 0.3, 0.6, 5.0, 1e6, -0.01, math.nan)
"""By how much a clock may go on between two states, beside a period [s]."""

SIZES = (-2.0, -1.45, -0.3, 0.02, 0.3, 1.45, 2.0)
"""How large a fault is; some are within what is allowed."""

STARTS_RAD = (0.0, 0.97, -0.99, 1.0)
"""Where the joints stand at first, in and at their limits of 1 rad."""


def contact_force(state: HandState) -> float:
    """A force that passes its limit before any torque does [N]."""
    return 10.0 * float(np.abs(state.tau_nm).max())


class TriedHand(FakeHand):
    """A hand whose clocks and faults are told to it; it judges every command that reaches it."""

    def __init__(self, *, real_time: bool, start_rad: float) -> None:
        super().__init__(real_time=real_time)
        self.q = np.array([start_rad, -start_rad])
        self.own_s, self.hand_s, self.wait_s, self.act_s = 100.0, 5.0, 0.0, 0.0
        self.fault, self.size = "", 0.0
        self.given: HandState | None = None
        self.sound = False
        self.base: tuple[np.ndarray, float, float] | None = None
        self.sent = 0
        self.wrong: list[str] = []

    def observe(self) -> HandState:
        self.own_s += self.wait_s
        if self.fault == "drop":
            raise ConnectionResetError("gone")
        if self.fault == "exit":
            raise SystemExit(0)
        state = self.given if self.fault == "copy" and self.given is not None else self._state()
        self.sound = self.fault != "none" and is_sound(state)
        if self.sound and self.sent == 0:
            # Until the first command the hand holds to what it says, since the first state.
            since = (state.time_s, self.own_s) if self.base is None else self.base[1:]
            self.base = (state.q_desired_rad.copy(), *since)
        self.given = state
        return state if self.fault != "none" else None  # type: ignore[return-value]

    def _state(self) -> HandState:
        zeros, t, odd = np.zeros(2), self.hand_s, np.array([0.0, self.size])
        state = HandState(
            t, self.q.copy(), zeros, zeros.copy(), self.q.copy(), np.full(4, 7.0), np.full(4, t)
        )
        if self.fault == "angle":
            state.q_rad[:] += odd
        elif self.fault == "velocity":
            state.dq_rad_per_s[:] = 4 * odd
        elif self.fault in ("torque", "force"):
            state.tau_nm[:] = odd if self.fault == "torque" else 0.6 * odd
        elif self.fault == "desired":
            state.q_desired_rad[:] += odd
        elif self.fault == "nan":
            state.tau_nm[1] = math.nan
        elif self.fault == "old":
            state.taxel_time_s[:] -= abs(self.size)
        elif self.fault == "counts":
            state.taxels[:] = np.rint(200 * abs(self.size))
        return state

    def act(self, command: HandCommand) -> None:
        q = command.q_desired_rad
        if not self.sound:
            self.wrong.append(f"a command after a bad state ({self.fault})")
        if self.stopped_at is not None:
            self.wrong.append("a command after stop()")
        if not ((q >= LOW - ROUNDING) & (q <= HIGH + ROUNDING)).all():
            self.wrong.append(f"a command beyond the joint limits: {q}")
        assert self.given is not None
        assert self.base is not None
        before, hand_s, own_s = self.base
        passed_s = min(self.given.time_s - hand_s, PERIOD_S)
        if self.real_time:
            passed_s = min(passed_s, self.own_s - own_s)
        if (np.abs(q - before) > LIMITS.velocity_rad_per_s * passed_s + ROUNDING).any():
            self.wrong.append(f"a step of {q - before} rad in {passed_s:.6f} s")
        self.base = (q.copy(), self.given.time_s, self.own_s)
        self.q = q.copy()
        self.sent += 1
        self.own_s += self.act_s


def is_sound(state: HandState) -> bool:
    """Return True if a state is within the limits of the hand."""
    angles = np.stack([state.q_rad, state.q_desired_rad])
    margin = OPTIONS.joint_margin_rad + ROUNDING
    return bool(
        math.isfinite(state.time_s)
        and ((angles >= LOW - margin) & (angles <= HIGH + margin)).all()
        and (np.abs(state.dq_rad_per_s) <= 2 * LIMITS.velocity_rad_per_s).all()
        and (np.abs(state.tau_nm) <= LIMITS.torque_nm).all()
        and contact_force(state) <= FORCE_N
        and state.taxels.max() <= 255
    )


class Trial:
    """One connection of a tried hand behind its guard."""

    def __init__(self, *, real_time: bool, start_rad: float) -> None:
        self.hand = TriedHand(real_time=real_time, start_rad=start_rad)
        self.guard = GuardedHand(self.hand, OPTIONS, contact_force, lambda: self.hand.own_s)
        self.guard.connect()

    def observe(self, hand_s: float, own_s: float, fault: str = "", size: float = 0.0) -> None:
        """The next state; both clocks go on by so much, whatever that is."""
        hand = self.hand
        hand.hand_s += hand_s
        hand.wait_s = own_s if own_s >= 0 else 0.0
        hand.fault, hand.size = fault, size
        self._expect_stop_on_error(self.guard.observe)

    def command(self, q_rad: np.ndarray, own_s: float, act_s: float, *, near: bool) -> None:
        """A command: as it is, or the nearest that is allowed."""
        self.hand.own_s += own_s
        self.hand.act_s = act_s
        if self.hand.base is None or self.guard.failure is not None:
            return
        self._expect_stop_on_error(
            lambda: self.guard.act(self.guard.nearest(q_rad) if near else HandCommand(q_rad))
        )

    def step(self, step_rad: np.ndarray, own_s: float, act_s: float) -> None:
        """A command that steps from where the hand was sent."""
        if self.hand.base is not None:
            self.command(self.hand.base[0] + step_rad, own_s, act_s, near=False)

    def _expect_stop_on_error(self, work: object) -> None:
        try:
            work()  # type: ignore[operator]
        except HandError:
            assert self.hand.stopped_at is not None
        assert not self.hand.wrong, self.hand.wrong

    def end(self) -> None:
        """Leaves the guard's block."""
        self.guard.__exit__(None, None, None)
        assert self.hand.stopped_at is not None


def random_sequence(rng: np.random.Generator, most: int = 60) -> int:
    """One random sequence; returns how many commands reached the hand."""
    trial = Trial(real_time=bool(rng.random() < 0.7), start_rad=float(rng.choice(STARTS_RAD)))
    try:
        for _ in range(rng.integers(2, most)):
            _random_call(trial, rng)
    finally:
        trial.end()
    return trial.hand.sent


def _random_call(trial: Trial, rng: np.random.Generator) -> None:
    odd, own_s, act_s = rng.random(), 0.001 * rng.random(), 0.002 * rng.random() * (rng.random() < 0.3)
    if rng.random() < 0.55:
        jitter = 1 + 0.2 * rng.standard_normal()
        hand_s = float(rng.choice(STEPS_S)) if odd < 0.04 else PERIOD_S
        wait_s = float(rng.choice(STEPS_S[:8])) if rng.random() < 0.04 else PERIOD_S * abs(jitter)
        fault = str(rng.choice(FAULTS)) if rng.random() < 0.05 else ""
        trial.observe(hand_s, wait_s, fault, float(rng.choice(SIZES)))
    elif odd < 0.85:
        trial.command(rng.uniform(-3, 3, 2), own_s, act_s, near=True)
    elif odd < 0.98:
        trial.step(rng.uniform(-0.022, 0.022, 2) * rng.random(), own_s, act_s)
    elif odd < 0.995:
        trial.command(rng.choice([-2.0, 0.0, 1.0, math.nan, math.inf], 2), own_s, act_s, near=False)
    else:
        trial.guard.stop()


CLOCK = st.sampled_from(STEPS_S) | st.floats(0.0, 0.03)
OWN = st.floats(0.0, 0.02)
ANGLES = st.tuples(st.floats(-4, 4), st.floats(-4, 4)).map(np.array)
STEPS = st.tuples(st.floats(-0.021, 0.021), st.floats(-0.021, 0.021)).map(np.array)


class Sequences(RuleBasedStateMachine):
    """Calls between a hand and its user, in any order."""

    trial: Trial | None = None

    @initialize(real_time=st.booleans(), start_rad=st.sampled_from(STARTS_RAD))
    def connect(self, real_time: bool, start_rad: float) -> None:
        self.trial = Trial(real_time=real_time, start_rad=start_rad)
        self.trial.observe(PERIOD_S, PERIOD_S)

    @rule(own_s=OWN)
    def good_state(self, own_s: float) -> None:
        self.trial.observe(PERIOD_S, own_s)

    @rule(hand_s=CLOCK, own_s=CLOCK)
    def odd_clock(self, hand_s: float, own_s: float) -> None:
        self.trial.observe(hand_s, own_s if own_s < 1e6 else 0.0)

    @rule(fault=st.sampled_from(FAULTS), size=st.sampled_from(SIZES))
    def odd_state(self, fault: str, size: float) -> None:
        self.trial.observe(PERIOD_S, PERIOD_S, fault, size)

    @rule(q_rad=ANGLES, own_s=OWN, act_s=OWN)
    def nearest_command(self, q_rad: np.ndarray, own_s: float, act_s: float) -> None:
        self.trial.command(q_rad, own_s, act_s, near=True)

    @rule(step_rad=STEPS, own_s=OWN, act_s=OWN)
    def small_step(self, step_rad: np.ndarray, own_s: float, act_s: float) -> None:
        self.trial.step(step_rad, own_s, act_s)

    @rule(q_rad=ANGLES, own_s=OWN)
    def any_command(self, q_rad: np.ndarray, own_s: float) -> None:
        self.trial.command(q_rad, own_s, 0.0, near=False)

    @rule()
    def stop(self) -> None:
        self.trial.guard.stop()

    def teardown(self) -> None:
        if self.trial is not None:
            self.trial.end()


def test_no_sequence_breaks_a_limit() -> None:
    quick = settings(
        max_examples=120, stateful_step_count=20, deadline=None, suppress_health_check=[HealthCheck.too_slow]
    )
    run_state_machine_as_test(Sequences, settings=quick)


def test_random_sequences_reach_the_hand() -> None:
    rng = np.random.default_rng(1)
    assert sum(random_sequence(rng) for _ in range(400)) > 1000


@pytest.mark.slow
def test_many_random_sequences() -> None:
    count, seed = int(os.environ.get("SEQUENCES", "3000")), int(os.environ.get("SEED", "7"))
    rng = np.random.default_rng(seed)
    sent = sum(random_sequence(rng) for _ in range(count))
    print(f"{count} sequences, {sent} commands reached the hand, none of them beyond a limit")
    assert sent > count
