"""The time after which a request is repeated follows the link."""

from __future__ import annotations

import pytest

from skincal.hand.resend import LONGEST_S, SHORTEST_S, ResendTimer


def test_untimed_link_is_given_the_longest_time() -> None:
    assert ResendTimer().wait_s == LONGEST_S


def test_steady_link_is_given_little_more_than_it_takes() -> None:
    timer = ResendTimer()
    for _ in range(30):
        timer.answered(0.04)
    assert 0.04 <= timer.wait_s < 0.045


def test_an_unsteady_link_is_given_more() -> None:
    steady, unsteady = ResendTimer(), ResendTimer()
    for k in range(30):
        steady.answered(0.05)
        unsteady.answered(0.03 if k % 2 else 0.07)
    assert unsteady.wait_s > 0.07 > steady.wait_s


def test_repeats_wait_longer_until_an_answer_is_timed() -> None:
    timer = ResendTimer()
    for _ in range(30):
        timer.answered(0.04)
    before = timer.wait_s
    timer.repeated()
    assert timer.wait_s == pytest.approx(2 * before)
    for _ in range(9):
        timer.repeated()
    assert timer.wait_s == LONGEST_S
    timer.answered(0.04)
    assert timer.wait_s == pytest.approx(before, rel=0.1)


def test_the_fastest_link_is_given_some_time() -> None:
    timer = ResendTimer()
    for _ in range(50):
        timer.answered(1e-4)
    assert timer.wait_s == SHORTEST_S
