"""No sequence of states, commands and faults gets a command past the guard that breaks a limit."""

from __future__ import annotations

import os

import numpy as np
import pytest
from guard_sequences import FAULTS, SIZES, STARTS_RAD, STEPS_S, Trial, random_sequence
from hand_fakes import PERIOD_S
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

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
