"""The hand's clock against ours."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from skincal.hand.checks import DRIFT, ClockCheck
from skincal.hand.errors import HandError
from skincal.hand.guard_options import GuardOptions

PERIOD_S = 0.01


def found(
    hand_s: np.ndarray, own_s: np.ndarray, *, real_time: bool, recorded: bool = False, **options: float
) -> str:
    """Return the fault of a series of states, or an empty text; each is waited for since the one before."""
    check = ClockCheck(GuardOptions(**options), real_time=real_time, period_s=PERIOD_S, recorded=recorded)
    waited = [0.0, *(after - before for before, after in pairwise(own_s))]
    for t, own, wait in zip(hand_s, own_s, waited, strict=True):
        try:
            check(float(t), float(own), float(wait))
        except HandError as violation:
            assert violation.kind == "clock"
            return str(violation)
    return ""


def ticks(count: int, step_s: float = PERIOD_S) -> np.ndarray:
    return step_s * np.arange(count)


def test_states_that_fill_a_queue_are_late() -> None:
    assert "late, the limit is 0.5 s" in found(ticks(200), ticks(200, 0.02), real_time=True)
    assert found(ticks(200), ticks(200), real_time=True) == ""


def test_one_wait_makes_all_states_after_it_late() -> None:
    own = ticks(50) + 0.6 * (np.arange(50) > 20)
    assert "0.6 s late" in found(ticks(50), own, real_time=True)
    assert found(ticks(50) + 0.6 * (np.arange(50) > 20), own, real_time=True) == ""


def test_crystals_that_differ_are_borne_for_hours() -> None:
    hours = ticks(100_000, 0.1)
    for share in (-0.5 * DRIFT, 0.5 * DRIFT):
        assert found(hours * (1 + share), hours, real_time=True) == ""
    assert "late" in found(hours * (1 - 3 * DRIFT), hours, real_time=True)


def test_a_clock_that_runs_ahead() -> None:
    text = found(ticks(200), ticks(200, 0.001), real_time=True)
    assert "ahead of ours, the limit is 0.5 s" in text
    assert "real_time = False" in text
    assert found(ticks(200), ticks(200, 0.001), real_time=False) == ""


def test_a_prompt_state_after_a_late_one_is_no_jump() -> None:
    """A lost answer is asked for again: the same state comes late, and the next one is new."""
    hand = np.array([0.0, 0.08, 0.16, 0.35, 0.43])
    own = np.array([0.0, 0.08, 0.31, 0.35, 0.43])
    assert found(hand, own, real_time=True) == ""
    assert "jumped" in found(hand + 0.2 * (np.arange(5) > 2), own, real_time=True)


def test_a_clock_that_jumps() -> None:
    jump = ticks(50) + 1e6 * (np.arange(50) > 20)
    for real_time in (True, False):
        assert "jumped by 1e+06 s" in found(jump, ticks(50), real_time=real_time)
    # Nobody looked at the hand for a while; a record has gaps.
    assert found(jump, jump, real_time=True) == ""
    assert found(jump, ticks(50), real_time=False, recorded=True) == ""


def test_a_simulated_hand_that_is_far_too_slow() -> None:
    assert "late" in found(ticks(5), ticks(5, 0.95), real_time=False)
    assert "late" in found(ticks(20), ticks(20, 0.3), real_time=False)
    assert found(ticks(200), ticks(200, 0.05), real_time=False) == ""
    assert found(ticks(2), ticks(2, 0.95), real_time=False, timeout_s=3.0) == ""
