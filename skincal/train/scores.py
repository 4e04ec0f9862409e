"""Scores of an evaluation: errors over time with intervals, drops, directions."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from skincal.model.arrays import BoolArray, FloatArray

SETTLED_S = (2.0, 8.0)
"""The part of a marble's run that counts as settled [s]: the circle, after the way from the centre to the side."""

LEVEL = 0.95
RESAMPLES = 1000
RIGHT_WITHIN_RAD = np.pi / 8
"""A bolt rolls in the right direction if it is off by less than half of what lies between two orientations."""

RIGHT_SHARE = 0.25
"""... and if it follows at least this part of the target's way."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Runs:
    """Episodes of one policy; N episodes, T steps. After an episode's end everything is NaN.

    Attributes:
        time_s: end of each step, shape (T,) [s].
        error_m: distance between object and target, shape (N, T) [m].
        object_m: where the object touches the skin, from the sensor's centre, shape (N, T, 2) [m].
        target_m: where it should, shape (N, T, 2) [m].
        dropped: whether the object was lost, shape (N,).
        angle_error_rad: by how much a bolt has turned, shape (N, T) [rad]; NaN for a marble.
        orientation_deg: of a bolt, shape (N,) [°]; NaN for a marble.
        rewards: sum of each episode, shape (N,).
    """

    time_s: FloatArray
    error_m: FloatArray
    object_m: FloatArray
    target_m: FloatArray
    dropped: BoolArray
    angle_error_rad: FloatArray
    orientation_deg: FloatArray
    rewards: FloatArray

    @classmethod
    def empty(cls, episodes: int, steps: int, rate_hz: float) -> Runs:
        """Return runs in which nothing has happened yet, to be filled in; their rewards are 0."""
        n, t = episodes, steps
        return cls(
            time_s=np.arange(1, t + 1) / rate_hz,
            error_m=np.full((n, t), np.nan),
            object_m=np.full((n, t, 2), np.nan),
            target_m=np.full((n, t, 2), np.nan),
            dropped=np.zeros(n, dtype=np.bool_),
            angle_error_rad=np.full((n, t), np.nan),
            orientation_deg=np.full(n, np.nan),
            rewards=np.zeros(n),
        )

    def __len__(self) -> int:
        return len(self.error_m)

    def of(self, rows: BoolArray) -> Runs:
        """Return some of the episodes."""
        parts = {item.name: getattr(self, item.name) for item in fields(self) if item.name != "time_s"}
        return Runs(time_s=self.time_s, **{name: values[rows] for name, values in parts.items()})


@dataclass(frozen=True, eq=False)
class Score:
    """Figures of one policy. Means are over the runs still going at that time; NaN where there is none.

    Attributes:
        drops: runs in which the object was lost.
        time_s: shape (T,) [s].
        error_m: mean tracking error, shape (T,) [m].
        error_low_m: lower end of its 95 % interval over runs, shape (T,) [m].
        error_high_m: upper end, shape (T,) [m].
        error_settled_m: mean of the mean error from 2 s to 8 s [m].
        error_settled_interval_m: its 95 % interval [m].
        reward: mean sum of an episode.
    """

    episodes: int
    drops: int
    time_s: FloatArray
    error_m: FloatArray
    error_low_m: FloatArray
    error_high_m: FloatArray
    error_settled_m: float
    error_settled_interval_m: tuple[float, float]
    error_end_m: float
    reward: float

    @property
    def success(self) -> float:
        """Share of runs that went to the end."""
        return 1.0 - self.drops / self.episodes


@dataclass(frozen=True)
class Rolling:
    """Scores of a rolled bolt.

    Attributes:
        drops: runs in which it was lost.
        direction_right: share of runs in which it was rolled as its orientation asks.
        held_to_end: share of runs that went to the end.
        held_s: mean time that it was held [s].
        angle_error_rad: mean amount by which it had turned from its first orientation [rad].
    """

    episodes: int
    drops: int
    direction_right: float
    held_to_end: float
    held_s: float
    angle_error_rad: float
    by_orientation_deg: dict[str, Rolling] = field(default_factory=dict[str, "Rolling"])


def score(runs: Runs, rng: np.random.Generator) -> Score:
    """Sum up the tracking errors of a policy."""
    mean = mean_error_m(runs.error_m, np.ones((1, len(runs))))[0]
    draws = rng.multinomial(len(runs), np.full(len(runs), 1.0 / len(runs)), RESAMPLES)
    resampled = mean_error_m(runs.error_m, draws)
    low, high = _interval(resampled)
    settled = (runs.time_s >= SETTLED_S[0]) & (runs.time_s <= SETTLED_S[1] + 1e-9)
    settled_low, settled_high = _interval(mean_of_finite(resampled[:, settled])[:, None])
    return Score(
        episodes=len(runs),
        drops=int(runs.dropped.sum()),
        time_s=runs.time_s,
        error_m=mean,
        error_low_m=low,
        error_high_m=high,
        error_settled_m=float(mean_of_finite(mean[None, settled])[0]),
        error_settled_interval_m=(float(settled_low[0]), float(settled_high[0])),
        error_end_m=float(mean[-1]),
        reward=float(runs.rewards.mean()),
    )


def mean_error_m(error_m: FloatArray, weights: NDArray[np.integer] | FloatArray) -> FloatArray:
    """Return the mean (B, T) over the episodes still going; NaN where none goes on.

    Args:
        error_m: shape (N, T), NaN after an episode's end.
        weights: how often each episode counts, shape (B, N).
    """
    going = np.isfinite(error_m)
    number = weights @ going.astype(np.float64)
    total = weights @ np.where(going, error_m, 0.0)
    return np.divide(total, number, out=np.full_like(total, np.nan), where=number > 0)


def rolling(runs: Runs) -> Rolling:
    """Sum up how a bolt was rolled, over all orientations and for each."""
    orientations = sorted(set(runs.orientation_deg.tolist()))
    parts = {f"{degrees:g}": _rolling(runs.of(runs.orientation_deg == degrees)) for degrees in orientations}
    return replace(_rolling(runs), by_orientation_deg=parts)


def _rolling(runs: Runs) -> Rolling:
    going = np.isfinite(runs.error_m)
    step_s = float(runs.time_s[0])
    right = [direction_right(o, t) for o, t in zip(runs.object_m, runs.target_m, strict=True)]
    return Rolling(
        episodes=len(runs),
        drops=int(runs.dropped.sum()),
        direction_right=float(np.mean(right)),
        held_to_end=1.0 - float(runs.dropped.mean()),
        held_s=float(going.sum(axis=1).mean() * step_s),
        angle_error_rad=float(mean_of_finite(np.abs(runs.angle_error_rad).ravel()[None])[0]),
    )


def direction_right(object_m: FloatArray, target_m: FloatArray) -> bool:
    """Return whether an object moves the way its target moves.

    The way is what the place of the object gains while the target goes ahead, by regression; it must point along the
    target's line to within :data:`RIGHT_WITHIN_RAD` and be no less than :data:`RIGHT_SHARE` of it.

    Args:
        object_m: places of the object, shape (T, 2) [m]; NaN after the end.
        target_m: places of the target, on a line, shape (T, 2) [m].
    """
    going = np.isfinite(object_m).all(axis=1) & np.isfinite(target_m).all(axis=1)
    if going.sum() < 3:
        return False
    place = object_m[going] - object_m[going].mean(axis=0)
    target = target_m[going] - target_m[going].mean(axis=0)
    along = np.linalg.svd(target, full_matrices=False)[2][0]
    ahead = target @ along
    if not ahead @ ahead > 0.0:
        return False
    way = place.T @ ahead / (ahead @ ahead)
    length = float(np.linalg.norm(way))
    return bool(length >= RIGHT_SHARE and way @ along > length * np.cos(RIGHT_WITHIN_RAD))


def _interval(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper end of the interval of values (B, T) over draws; NaN where any draw has nothing."""
    tail = (1.0 - LEVEL) / 2.0
    low, high = np.quantile(values, (tail, 1.0 - tail), axis=0)
    return low, high


def mean_of_finite(values: FloatArray) -> FloatArray:
    """Return the mean of each row over what is finite; NaN of nothing."""
    finite = np.isfinite(values)
    number = finite.sum(axis=1)
    total = np.where(finite, values, 0.0).sum(axis=1)
    return np.divide(total, number, out=np.full(len(values), np.nan), where=number > 0)


@dataclass(frozen=True)
class Fare:
    """A prediction for one hand.

    Attributes:
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
    from scipy.stats import binomtest  # takes a moment, and few evaluations predict

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
