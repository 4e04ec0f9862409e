"""Detect temporary faults of single taxels: steps of the level, and taxels that are stuck at one value.

Both are detected relative to the best model, if that leaves a significant residual, in the series of holds and rests of
each taxel.

A taxel is stuck in a run of presses in which it reads one value although the model predicts a change. Taxels stuck
away from their level at rest, which respond again later or stand at an end of the converter, are detected before the
first fit, relative to the calibration: a few of them bias every fit, and an effect such as a taxel offset would absorb
them.

A step is a changepoint: a window of presses in which a separate level explains most of the residual of the taxel's own
curve. The curve contains what effects can do smoothly: a nonlinear response, another one while the load falls, and slow
drifts of level and gain. The likelihood ratio, with the residual variance of the curve, must exceed a Bonferroni bound
over all windows and taxels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline

from skincal.effects import Stage, effect
from skincal.effects.samples import HOLD, UNLOAD
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitter
from skincal.inference.forward import State
from skincal.inference.session import GapSession
from skincal.model.arrays import BoolArray, FloatArray, IntArray

FALSE_ALARM = 0.01
"""Probability of a false step in a session, over all taxels and windows."""
_FLAT_SIGMAS = 4.0
"""Range of the readings of a stuck taxel, at most [noise standard deviations]."""
_FAR_SIGMAS, _FAR_RANGE = 10.0, 0.3
"""Least change that the model predicts for a stuck taxel: in noise standard deviations, and in its predicted range."""
_MOST_STEPS = 3
"""Largest number of steps of a taxel."""
_EXPLAINED = 0.4
"""Share of the residual sum of squares that a step explains at least. A smooth curve outside the basis leaves more.
Set by eye."""
_LEAST_BLOCKS, _KNOTS = 2, 5
"""Least number of presses within and outside a window, and number of knots of the drift in time."""


@dataclass(frozen=True, eq=False)
class TaxelFault:
    """A temporary fault of a taxel.

    Attributes:
        taxel: index of the taxel.
        blocks: keys of the affected presses and rests (:func:`block_keys`).
        press: row of the first affected press.
        begin_s: begin, from the begin of the session [s]; NaN without a clock.
        end_s: end [s]; NaN without a clock, infinite if the fault lasts to the end.
        lasts: whether the fault lasts to the end of the session.
        counts: height of the step, or the value at which the taxel is stuck [counts].
        stuck: whether the taxel is stuck; otherwise its level steps.
    """

    taxel: int
    blocks: IntArray
    press: int
    begin_s: float
    end_s: float
    lasts: bool
    counts: float
    stuck: bool


def block_keys(press: IntArray) -> IntArray:
    """Return the key (N,) of the block of each observation.

    The key of a press is its row, that of the rest after it is -2 - row, and that of the rest at the beginning is -1.
    """
    last = np.maximum.accumulate(np.where(press >= 0, np.arange(len(press)), -1))
    before = np.where(last >= 0, press[np.maximum(last, 0)], -1)
    return np.where(press >= 0, press, np.where(before >= 0, -2 - before, -1))


def remove_faults(session: GapSession, faults: Sequence[TaxelFault]) -> GapSession:
    """Return the session with steps subtracted, and NaN for the readings of stuck taxels."""
    assert session.counts is not None
    counts, keys = session.counts.copy(), block_keys(session.press)
    for fault in faults:
        rows = np.isin(keys, fault.blocks)
        counts[rows, fault.taxel] -= np.nan if fault.stuck else fault.counts
    return replace(session, counts=counts)


def find_faults(
    session: GapSession, fitter: Fitter, state: State, *, state_is_calibrated: bool = False
) -> tuple[TaxelFault, ...]:
    """Detect the temporary faults of a session relative to a fit.

    Args:
        session: the session, test presses included.
        fitter: fitter of the session.
        state: state of the fit.
        state_is_calibrated: whether the state is that of a calibration. Then only taxels that are stuck away from
            their level at rest are detected.
    """
    forward = fitter.forward
    assert session.counts is not None
    # Use the measured forces: the fitted ones absorb a part of the faults.
    state = replace(state, move=state.move * np.array([1.0, 1.0, 0.0]))
    if state_is_calibrated:
        # A calibration may have taken a stuck taxel for a dead one and given it almost no scale.
        state = replace(state, log_s=np.maximum(state.log_s, np.median(state.log_s)))
    level = forward.predict(state).values + state.rest
    expected = forward.mean @ forward.noise.written(level)[0]
    variance = forward.noise.variance(forward.mean @ level, fitter.frames)
    ends = forward.noise.low, forward.noise.high
    # Without effects of the converter: the curve of each taxel contains them, and in the fit they may follow a step.
    others = {n: v for n, v in state.effects.items() if effect(n).stage < Stage.CONVERTER}
    bare = forward.mean @ forward.predict(replace(state, effects=others)).values
    return detect_faults(
        session, session.counts, expected, variance, bare, ends, calibrated=state_is_calibrated
    )


def detect_faults(
    session: GapSession,
    counts: FloatArray,
    expected: FloatArray,
    variance: FloatArray,
    bare: FloatArray,
    ends: tuple[float, float] = (-np.inf, np.inf),
    *,
    calibrated: bool = False,
) -> tuple[TaxelFault, ...]:
    """Detect temporary faults relative to the predictions of a model.

    Args:
        session: presses, phases and times.
        counts: (N, J) readings [counts]; NaN where nothing was read.
        expected: (N, J) predictions [counts].
        variance: (N, J) variances of the noise [counts²].
        bare: (N, J) predictions above rest without effects of single values [counts].
        ends: ends of the converter's range [counts].
        calibrated: whether the predictions are those of a calibration, as in :func:`find_faults`.
    """
    keys = block_keys(session.press)
    starts = np.flatnonzero(np.diff(keys, prepend=keys[0] - 1))
    own = np.flatnonzero(session.observation >= 0)
    time = np.full(len(session), np.nan)
    if session.samples.time_s is not None:
        time[session.observation[own][::-1]] = session.samples.elapsed_s[own][::-1]

    def fault(taxel: int, begin: int, end: int, height: float, *, stuck: bool) -> TaxelFault:
        blocks = keys[starts[begin:end]]
        until = time[starts[end]] if end < len(starts) else np.inf
        press = int(blocks[blocks >= 0][0])
        lasts = end == len(starts)
        return TaxelFault(
            taxel, blocks, press, float(time[starts[begin]]), float(until), lasts, height, stuck
        )

    faults: list[TaxelFault] = []
    counts = counts.copy()
    for j in range(counts.shape[1]):
        sd = np.sqrt(variance[:, j])
        runs = _stuck_runs(counts[:, j], expected[:, j], sd, keys, starts, ends, calibrated=calibrated)
        for begin, end, level in runs:
            faults.append(fault(j, begin, end, level, stuck=True))
            counts[np.isin(keys, faults[-1].blocks), j] = np.nan
    if calibrated:
        return tuple(faults)
    series = _block_means(session, counts, bare, variance, starts)
    for j in range(counts.shape[1]):
        for begin, end, height in _steps(series, j, keys[starts] >= 0):
            faults.append(fault(j, begin, end, height, stuck=False))
    return tuple(faults)


def _stuck_runs(
    y: FloatArray,
    expected: FloatArray,
    sd: FloatArray,
    keys: IntArray,
    starts: IntArray,
    ends: tuple[float, float],
    *,
    calibrated: bool,
) -> list[tuple[int, int, float]]:
    """Return the runs of blocks [begin, end) in which a taxel is stuck, each with the value that it reads."""
    stops = np.append(starts[1:], len(y))
    flat = _FLAT_SIGMAS * float(np.median(sd))
    far = max(_FAR_SIGMAS * float(np.median(sd)), _FAR_RANGE * float(np.ptp(expected)))
    is_pressed = keys[starts] >= 0
    found, begin = list[tuple[int, int, float]](), 0
    while begin < len(starts):
        # Extend the run while all readings stay within ``flat``.
        low, top, end = np.inf, -np.inf, begin
        while end < len(starts):
            part = y[starts[end] : stops[end]]
            least = min(low, np.nanmin(part, initial=np.inf))
            most = max(top, np.nanmax(part, initial=-np.inf))
            if most - least > flat:
                break
            low, top, end = least, most, end + 1
        level, run = 0.5 * (low + top), slice(starts[begin], stops[max(end - 1, begin)])
        is_off = np.abs(expected - level) > far
        presses_off = sum(is_pressed[b] and is_off[starts[b] : stops[b]].any() for b in range(begin, end))
        # A taxel at its level at rest may only have been missed by the press: this requires one press more.
        at_rest = abs(level - float(expected.min())) <= flat
        later = starts[end] if end < len(starts) else len(y)
        responds_later = bool(is_pressed[end:].any()) and bool(np.isfinite(y[later:]).any())
        # A taxel at an end of the converter is disconnected; elsewhere it may have died for good, which is an effect.
        at_end = not at_rest and min(abs(level - x) for x in ends) < flat
        if (
            presses_off >= _LEAST_BLOCKS + at_rest
            and np.ptp(expected[run]) > far
            and (responds_later or at_end)
            and not (calibrated and at_rest)
        ):
            # Include the presses during which the fault begins and ends.
            is_stuck = is_off & (np.abs(y - level) <= flat)
            earlier = begin - (begin > 0 and bool(is_stuck[starts[begin] - 1]))
            found.append((earlier, end + (end < len(starts) and bool(is_stuck[later])), level))
        begin = max(end, begin + 1)
    return found


@dataclass(frozen=True, eq=False)
class _BlockMeans:
    """Means over blocks: the hold of each press, and each rest.

    Attributes:
        y: (B, J) readings [counts].
        x: (B, J) predictions above rest [counts].
        variance: (B, J) variances of the readings [counts²].
        falling: (B,) whether the hold was reached from a larger load.
    """

    y: FloatArray
    x: FloatArray
    variance: FloatArray
    falling: BoolArray


def _block_means(
    session: GapSession, counts: FloatArray, bare: FloatArray, variance: FloatArray, starts: IntArray
) -> _BlockMeans:
    """Average readings and predictions over the hold of each press and over each rest, weighted by frames."""
    ends = np.append(starts[1:], len(counts))
    y, x, v = (np.full((len(starts), counts.shape[1]), np.nan) for _ in range(3))
    falling = np.zeros(len(starts), dtype=np.bool_)
    for b, (begin, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        rows = np.arange(begin, end)
        held = rows[session.phase[rows] == HOLD] if session.press[begin] >= 0 else rows
        held = held if len(held) else rows
        before = session.phase[begin : held[0]]
        falling[b] = len(before) > 0 and before[-1] == UNLOAD
        w = session.frames[held][:, None] * np.isfinite(counts[held])
        total = np.maximum(w.sum(axis=0), 1e-12)
        y[b] = np.where(w.sum(axis=0) > 0, (w * np.nan_to_num(counts[held])).sum(axis=0) / total, np.nan)
        x[b] = (w * bare[held]).sum(axis=0) / total
        v[b] = (w**2 * variance[held]).sum(axis=0) / total**2
    # Image error and force error of a press add to the noise.
    return _BlockMeans(y, x, v + (C.image**2 + C.force**2) * x**2, falling)


def _steps(s: _BlockMeans, taxel: int, is_pressed: BoolArray) -> list[tuple[int, int, float]]:
    """Return the windows of blocks [begin, end) in which a taxel has another level, each with the step [counts].

    Windows are added one by one, each with the largest reduction of the residual sum of squares.
    """
    use = np.flatnonzero(np.isfinite(s.y[:, taxel]))
    if not len(use):
        return []
    y, x = s.y[use, taxel], s.x[use, taxel] / max(float(np.nanmax(s.x[:, taxel], initial=0.0)), 1e-12)
    weight = 1 / np.sqrt(np.maximum(s.variance[use, taxel], 1e-12))
    basis = _curve_basis(x, s.falling[use], use / max(len(s.y) - 1, 1)) * weight[:, None]
    count, windows = len(use), list[tuple[int, int]]()
    presses_before = np.concatenate([[0], np.cumsum(is_pressed[use])])
    whitened = weight * y
    for _ in range(_MOST_STEPS):
        u, size, _ = np.linalg.svd(basis, full_matrices=False)
        q = u[:, size > 1e-9 * size[0]]
        dof = count - q.shape[1] - 1
        if dof < 4:
            break
        # Reduction of the sum of squares by each window [begin, end), from cumulative sums.
        residual = whitened - q @ (q.T @ whitened)
        slope = np.concatenate([[0.0], np.cumsum(weight * residual)])
        along = np.concatenate([np.zeros((1, q.shape[1])), np.cumsum(weight[:, None] * q, axis=0)])
        square = np.concatenate([[0.0], np.cumsum(weight**2)])
        share = np.einsum("ik,ik->i", along, along)
        curvature = square[None] - square[:, None] - (share[None] + share[:, None] - 2 * along @ along.T)
        presses = presses_before[None] - presses_before[:, None]
        allowed = (presses >= _LEAST_BLOCKS) & (presses <= presses_before[-1] - _LEAST_BLOCKS)
        allowed &= curvature > 1e-3 * np.maximum(square[None] - square[:, None], 1e-12)
        if not allowed.any():
            break
        gain = np.where(allowed, (slope[None] - slope[:, None]) ** 2 / np.where(allowed, curvature, 1.0), 0.0)
        begin, end = (int(k) for k in np.unravel_index(int(gain.argmax()), gain.shape))
        total, best = float(residual @ residual), float(gain[begin, end])
        if begin == 0:
            # A single step: the level differs from then on.
            begin, end = end, count
        tests = int(allowed.sum()) * s.y.shape[1]
        ratio = dof * np.log(total / max(total - best, 1e-9 * total))
        # Likelihood ratios with the residual variance and with that of the model: both must exceed the bound.
        if min(ratio, best) < 2 * np.log(tests / FALSE_ALARM) or best < _EXPLAINED * total:
            break
        column = np.zeros(count)
        column[begin:end] = 1.0
        basis = np.concatenate([basis, (weight * column)[:, None]], axis=1)
        windows.append((begin, end))
    if not windows:
        return []
    # Joint fit of the curve and all steps.
    coefficients, *_ = np.linalg.lstsq(basis, whitened, rcond=None)
    heights = coefficients[-len(windows) :]
    edges = np.append(use, len(s.y))
    return [(int(edges[b]), int(edges[e]), float(h)) for (b, e), h in zip(windows, heights, strict=True)]


def _curve_basis(x: FloatArray, falling: BoolArray, time: FloatArray) -> FloatArray:
    """Return the basis (B, n) of smooth responses to loads x, with drifts over the time from 0 to 1."""
    knots = np.concatenate([[0.0] * 3, np.linspace(0, 1, _KNOTS - 2), [1.0] * 3])
    drift = (
        BSpline.design_matrix(np.clip(time, 0.0, 1.0), knots, 3).toarray()
        if len(x) > 40
        else np.stack([np.ones_like(time), time], axis=1)
    )
    columns = [drift, x[:, None], (x**2)[:, None], (x * time)[:, None]]
    if falling.any():
        columns.append(np.stack([np.ones_like(x), x, x**2], axis=1) * falling[:, None])
    return np.concatenate(columns, axis=1)
