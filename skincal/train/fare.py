"""Prediction of a policy's results on one hand, from hands drawn from its calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from skincal.model.arrays import FloatArray
from skincal.train.scores import LEVEL, SETTLED_S, Runs, mean_of_finite


@dataclass(frozen=True)
class Fare:
    """A prediction for one hand.

    Attributes:
        hands: how many were drawn.
        success: share of them on which the object was held to the end.
        success_interval: of that share, at 95 % (Wilson).
        error_m: median over hands of a run's tracking error from 2 s on [m].
        error_interval_m: within which the next hand's run will lie: order statistics of the hands drawn, which hold
            whatever the distribution is.
        level: the chance with which it will: 95 %, or what so few hands allow, (n - 1) / (n + 1).
    """

    hands: int
    success: float
    success_interval: tuple[float, float]
    error_m: float
    error_interval_m: tuple[float, float]
    level: float


def fare(runs: Runs) -> Fare:
    """Predict from runs, each on another hand.

    Args:
        runs: at least one of them held until 2 s or longer, or the error is NaN.
    """
    errors = np.sort(settled_m(runs))
    errors = errors[np.isfinite(errors)]
    held, number = int((~runs.dropped).sum()), len(runs)
    interval = binomtest(held, number).proportion_ci(LEVEL, method="wilson")
    count = len(errors)
    # The next of n + 1 exchangeable values has each rank alike.
    rank = max(1, int(np.floor((1 - LEVEL) / 2 * (count + 1))))
    level = max(0.0, 1 - 2 * rank / (count + 1))
    ends = (float(errors[rank - 1]), float(errors[count - rank])) if count else (np.nan, np.nan)
    median = float(np.median(errors)) if count else float("nan")
    return Fare(number, held / number, (float(interval.low), float(interval.high)), median, ends, level)


def settled_m(runs: Runs) -> FloatArray:
    """Return the mean tracking error of each run from 2 s on (N,) [m]; NaN of one that was over by then."""
    return mean_of_finite(runs.error_m[:, runs.time_s >= SETTLED_S[0]])
