"""The null: which simulated sessions a session is compared with."""

from __future__ import annotations

import numpy as np
import pytest

from skincal.inference.null import FOUNDATION, Null

SQUARES = {FOUNDATION: 1.0, "near": 1.02, "far": 1.4}
GAINS = {FOUNDATION: 1.0, "near": 20.0, "far": 500.0}


def null() -> Null:
    laws = tuple(SQUARES) * 40
    own = np.array([GAINS[n] for n in laws])
    squares = np.array([SQUARES[n] for n in laws])
    return Null(laws, {"spread": own}, np.ones((len(laws), 3)), squares)


@pytest.mark.parametrize(
    ("left", "limit"),
    [(0.97, 8.0), (1.03, 25.0), (2.0, 625.0)],
)
def test_a_law_that_leaves_more_than_the_session_sets_no_limit(left: float, limit: float):
    assert null().of(left).limit("spread") == pytest.approx(limit)


def test_a_p_value_counts_sessions_of_laws_that_may_be():
    assert null().of(1.03).p_value("spread", 15.0) == pytest.approx(41 / 81)
    assert null().of(0.5).laws == (FOUNDATION,) * 40
