"""Noise before rounding, from the likelihood of rounded frames: for steps that are coarse against the noise.

A frame falls on a whole step k with probability ``Phi((k + 1/2 - level) / sigma) - Phi((k - 1/2 - level) / sigma)``.
The level of a taxel in a press is not known and is integrated over: as one level of the whole hold or, with less prior
probability, as two levels of its halves, and so on (a mixture over dyadic trees; Willems, Shtarkov and Tjalkens, IEEE
Trans. Inf. Theory 41 (1995) 653). Creep is thus not taken for noise, and a constant level uses all its frames.
Second differences, which need no levels, overestimate the noise if few levels lie near the edge of a step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from scipy.special import logsumexp, ndtr

from skincal.model.arrays import FloatArray, IntArray

_REACH = 3
"""Steps from the median frame that are distinguished; those beyond count as the last."""
_CELLS = np.arange(-_REACH, _REACH + 1)
_SIGMAS = np.geomspace(0.04, 2.0, 40)
"""Grid of the noise [steps]."""
_EDGE = np.linspace(-2.5, 2.5, 41)
_LEVELS = np.sort(
    np.column_stack(
        [
            np.tile(np.linspace(-1.0, 1.0, 41), (len(_SIGMAS), 1)),
            *(np.clip(edge + _EDGE * _SIGMAS[:, None], -1.0, 1.0) for edge in (-0.5, 0.5)),
        ]
    ),
    axis=1,
)
"""(S, L) levels about the middle frame [steps], dense about the edges of its step, where frames tell most."""
_WEIGHTS = np.log(np.maximum(np.gradient(_LEVELS, axis=1), 1e-12))
_GROWS = np.linspace(0.0, 0.1, 41)
_UNLIKELY = 1e-5
"""Probability of a reading that rounding and noise cannot explain."""
_SHORTEST, _PARTS, _HOLDS, _IDLE = 3, 12, 400, 1000
_SPLIT = 0.05
"""Prior probability that a level changes at half of a hold, and of its halves in turn."""
_TOLD = 4.5
"""Gain at which growth is accepted [nats]: three standard deviations."""
_OWN = 9.0
"""Gain at which a taxel gets a noise of its own [nats]: larger, as there are many taxels."""


@dataclass(frozen=True, eq=False)
class RoundedNoise:
    """Noise before rounding.

    Attributes:
        grows: part of the lift that is added to it, in quadrature.
        own: (J,) at rest, of each taxel [counts]: alike, but for those that are much noisier than the others.
        within: relative standard deviation of what is alike.
    """

    grows: float
    own: FloatArray
    within: float


@cache
def _log_shares(lowest: int) -> FloatArray:
    """Return log probabilities (S, L, cells) of frames; those below the cell ``lowest`` are clipped to it."""
    edges = np.append(_CELLS - 0.5, np.inf)
    edges[: lowest + _REACH + 1] = -np.inf
    share = np.diff(ndtr((edges - _LEVELS[..., None]) / _SIGMAS[:, None, None]), axis=-1)
    return np.log(np.maximum(share, _UNLIKELY))


def _by_level(k: IntArray, lowest: int) -> FloatArray:
    """Return the log-likelihood (B, S, L) of frames (n, B) on whole steps, by noise and level."""
    return np.tensordot(_numbers(k), _log_shares(lowest), axes=(1, 2))


def _numbers(k: IntArray) -> IntArray:
    """Return the number (B, cells) of frames (n, B) in each cell about the middle frame."""
    middle = np.sort(k, axis=0)[len(k) // 2]
    return (np.clip(k - middle, -_REACH, _REACH)[None] == _CELLS[:, None, None]).sum(axis=1).T


@lru_cache(maxsize=10_000)
def _of_hold(numbers: tuple[int, ...]) -> FloatArray:
    """Return the log-likelihood (S,) of the numbers (cells,) of frames of one level, which is integrated out."""
    return logsumexp(_log_shares(-_REACH) @ np.array(numbers) + _WEIGHTS, axis=1)


def _of_trees(k: IntArray, shortest: int) -> FloatArray:
    """Return the log-likelihood (B, S) of frames (n, B) whose levels are constant over parts of the hold."""
    one = np.stack([_of_hold(tuple(numbers)) for numbers in _numbers(k).tolist()])
    if len(k) < 2 * shortest:
        return one
    half = len(k) // 2
    two = _of_trees(k[:half], shortest) + _of_trees(k[half:], shortest)
    return np.logaddexp(one + np.log(1 - _SPLIT), two + np.log(_SPLIT))


def _holds(steps: FloatArray, hold: IntArray) -> Iterator[FloatArray]:
    groups = np.unique(hold[hold >= 0])
    for p in groups[:: len(groups) // _HOLDS + 1]:
        yield steps[hold == p]


def _at_rest(idle: FloatArray, lowest: float) -> FloatArray:
    """Return the log-likelihood (S,) of frames at rest (M, J), each taxel with a level of its own in each part."""
    total = np.zeros(len(_SIGMAS))
    for part in np.array_split(idle, len(idle) // _IDLE + 1):
        for own in part.T:
            k = own[np.isfinite(own)].astype(np.int64)
            if len(k) >= _SHORTEST:
                bound = (
                    int(np.clip(lowest - np.sort(k)[len(k) // 2], -_REACH, 0))
                    if np.isfinite(lowest)
                    else -_REACH
                )
                total += _by_level(k[:, None], bound)[0].max(axis=1)
    return total


def noise_of_rounded(
    counts: FloatArray,
    hold: IntArray,
    rest: IntArray,
    level: FloatArray,
    step: float,
    origin: float,
    low: float,
    high: float,
) -> RoundedNoise | None:
    """Estimate the noise from rounded frames; None if there are hardly any presses.

    Args:
        counts: (M, J) frames.
        hold: (M,) hold of each, -1 for none.
        rest: (M,) stretch of rest of each, -1 for none.
        level: (J,) level at rest.
        step: of the converter.
        origin: a value on the grid of steps.
        low: lower bound of the converter; -inf if there is none.
        high: upper bound.
    """
    steps = np.rint((counts - origin) / step)
    tables, lifts, taxels = [], [], []
    changes = np.nanmax(counts, axis=0, initial=-np.inf) > np.nanmin(counts, axis=0, initial=np.inf)
    for frames in _holds(steps, hold):
        mean = frames.mean(axis=0) * step + origin
        # Levels at rest are all at one place of the staircase; those of pressed taxels lie anywhere.
        with np.errstate(invalid="ignore"):
            seen = np.flatnonzero((mean > level + 1.5 * step) & (mean < high - 4 * step) & changes)
        if len(frames) >= _SHORTEST and len(seen):
            tables.append(_of_trees(frames[:, seen].astype(np.int64), max(_SHORTEST, len(frames) // _PARTS)))
            lifts.append(mean[seen] - level[seen])
            taxels.append(seen)
    if sum(map(len, taxels)) < 20:
        return None
    table, lift, taxel = np.concatenate(tables), np.concatenate(lifts), np.concatenate(taxels)
    logs = np.log(_SIGMAS)

    def at_rest(grows: float) -> FloatArray:
        """Return the log-likelihood (B, S) of every hold by the noise at rest."""
        wide = np.log(np.hypot(_SIGMAS, grows * lift[:, None] / step))
        place = np.clip((wide - logs[0]) / (logs[1] - logs[0]), 0.0, len(logs) - 1.001)
        k, rows = place.astype(np.int64), np.arange(len(table))[:, None]
        return table[rows, k] + (place - k) * (table[rows, k + 1] - table[rows, k])

    each = [at_rest(g) for g in _GROWS]
    total = np.stack([one.sum(axis=0) for one in each])
    if (rest >= 0).any():
        total += _unmoved(logs, _at_rest(steps[rest >= 0], (low - origin) / step), total)
    best = int(np.argmax(total.max(axis=1)))
    best = best if total[best].max() > total[0].max() + _TOLD else 0
    sigma, within = _top(logs, total.max(axis=0) if best else total[0])
    own = np.full(counts.shape[1], sigma)
    i = int(np.argmin(np.abs(logs - np.log(sigma))))
    for j in np.unique(taxel):
        mine = each[best][taxel == j].sum(axis=0)
        if mine.max() > mine[i] + _OWN and (noisy := _top(logs, mine)[0]) > 1.5 * sigma:
            own[j] = noisy
    return RoundedNoise(float(_GROWS[best]), own * step, within)


def _unmoved(logs: FloatArray, resting: FloatArray, pressed: FloatArray) -> FloatArray:
    """Return the log-likelihood (S,) at rest, or zeros if frames at rest scatter more than those of presses."""
    sigma, within = _top(logs, pressed.max(axis=0))
    near = logs < np.log(sigma) + 2.5 * within
    return resting if resting[near].max(initial=-np.inf) > resting.max() - _TOLD else np.zeros_like(resting)


def _top(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Return the maximum of log-likelihoods (S,) on a log grid, and its relative standard deviation, by a parabola."""
    i = int(np.clip(np.argmax(y), 1, len(x) - 2))
    bend = y[i - 1] - 2 * y[i] + y[i + 1]
    gap = x[1] - x[0]
    if bend >= 0:
        return float(np.exp(x[int(np.argmax(y))])), 1.0
    off = float(np.clip((y[i - 1] - y[i + 1]) / (2 * bend), -1.0, 1.0))
    return float(np.exp(x[i] + off * gap)), float(min(gap / np.sqrt(-bend), 1.0))
