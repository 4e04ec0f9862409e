"""Measure how much of the gap is closed, on test presses that neither the fit nor the selection has used.

Errors before and after are compared frame by frame: measured counts against the mean reading that the converter would
give. The contact of a press may move within its slack, before and after alike. A press whose image is an outlier under
both models is left out. The noise floor is the noise at the predicted values; it is never above the error of the better
model, since an error below it shows that the noise is smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from skincal.diagnosis.observed import Observed, frame_forward
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitter
from skincal.inference.forward import Forward, State
from skincal.inference.start import better_placement, candidate_placements, outlier_presses
from skincal.model.arrays import FloatArray, IntArray

_RESAMPLES, _STEPS = 400, 8
"""Bootstrap samples of an interval, and largest number of steps of a press placement."""
_FORCE_STEP = 0.02
"""Step of the difference quotient by the force, relative."""
_REFUTED = -1.0
"""Closed fraction below which the effects are refuted: the gap has more than doubled (in squares)."""
_NAN2 = (float("nan"), float("nan"))


@dataclass(frozen=True, eq=False)
class Gap:
    """The gap on the test presses.

    Attributes:
        before: root mean square error per taxel with the base model [counts].
        after: the same with the named effects [counts].
        floor: root mean square of the noise alone [counts].
        closed: (before² - after²) / (before² - floor²); NaN if there is no gap.
        interval: 95 % interval of ``closed``.
        increase: 95 % interval of after² - before² [counts²].
        unexplained: 95 % interval of the excess chi-square after, minus the part of the excess before that may remain,
            with the nuisance parameters of each press integrated out. Positive if too little of the gap is closed.
        presses: rows of the test presses used.
        frames: number of frames, or of hold means.
        slack_before_m: root mean square move of the contact positions with the base model [m].
        slack_after_m: the same with the named effects [m].
        errors: (P, 4) for each press: sums of squared errors before and after and of the noise, and their number.
    """

    before: float
    after: float
    floor: float
    closed: float
    interval: tuple[float, float]
    increase: tuple[float, float]
    unexplained: tuple[float, float]
    presses: IntArray
    frames: int
    slack_before_m: float
    slack_after_m: float
    errors: FloatArray

    @property
    def is_refuted(self) -> bool:
        """True if the error is significantly larger with the effects, or the gap has more than doubled."""
        return self.increase[0] > 0 or self.closed < _REFUTED

    @property
    def is_unexplained(self) -> bool:
        """True if significantly more of the gap remains than may remain, so that the effects do not explain it.

        This compares chi-squares, not fractions of the gap: of a very small gap, any fraction may seem to remain. The
        image error of the model is part of the noise here, because it remains whatever is named.
        """
        return self.unexplained[0] > 0


def place_presses(
    fitter: Fitter, state: State, rows: IntArray, others: Sequence[State] = (), placed: State | None = None
) -> State:
    """Return a state in which these presses have their best-fitting moves within the slack; all else is fixed.

    Args:
        fitter: fitter of the session, with these presses.
        state: fixes everything else.
        rows: rows of the presses.
        others: states whose moves are further initial guesses.
        placed: this state with the presses placed by an earlier call, which is not repeated; None: no such call.
    """
    plain = Fitter(fitter.forward, fitter.counts, replace(fitter.priors, image=0.0, errs=False))
    starts = [placed] if placed else candidate_placements(fitter, state, rows) or [state]
    starts += [replace(state, move=other.move) for other in others]
    best = reduce(
        better_placement, (plain.profile_presses(start, _STEPS, rows) for start in starts)
    ).state.move
    move = state.move.copy()
    move[rows] = best[rows]
    return replace(state, move=move)


def measure_gap(observed: Observed, before: State, after: State, rng: np.random.Generator) -> Gap:
    """Measure the gap on the test presses.

    Args:
        observed: the session.
        before: fit of the base model.
        after: fit with the named effects; ``before`` itself if there are none.
        rng: resamples whole presses for the intervals.
    """
    rows = np.flatnonzero(observed.is_test)
    fitter, forward = observed.fitter_of_all(), frame_forward(observed)
    first = place_presses(fitter, before, rows)
    if after is before:
        second = first
    else:
        # A press may have several local optima: each model also starts from the placement of the other.
        second = place_presses(fitter, after, rows, [first])
        first = place_presses(fitter, before, rows, [second], placed=first)
    # An image that is an outlier under both models is a fault of its press and says nothing about the models.
    rows = np.setdiff1d(rows, np.intersect1d(outlier_presses(fitter, first), outlier_presses(fitter, second)))
    errors = _press_errors(forward, observed, first, second, rows)
    errors = errors[errors[:, 3] > 0]
    if not len(errors):
        return Gap(0.0, 0.0, 0.0, float("nan"), _NAN2, _NAN2, _NAN2, rows, 0, 0.0, 0.0, errors)
    b, a, f, n = errors.sum(axis=0)
    scale = min(1.0, min(a, b) / f) if f > 0 else 1.0
    errors[:, 2] *= scale
    f *= scale
    drawn = errors[rng.integers(0, len(errors), (_RESAMPLES, len(errors)))].sum(axis=1)
    increase = (drawn[:, 1] - drawn[:, 0]) / drawn[:, 3]
    unexplained = _excess_chi2(fitter, second, rows) - (1 - C.closes) * _excess_chi2(fitter, first, rows)
    rows_drawn = rng.integers(0, len(unexplained), (_RESAMPLES, len(unexplained)))
    unexplained = unexplained[rows_drawn].sum(axis=1)
    return Gap(
        float(np.sqrt(b / n)), float(np.sqrt(a / n)), float(np.sqrt(f / n)), *_closed_fraction(b, a, f, drawn),
        _interval95(increase), _interval95(unexplained), rows, int(n // forward.layout.taxels),
        _rms_move_m(first.move[rows]), _rms_move_m(second.move[rows]), errors,
    )  # fmt: skip


def _press_errors(
    forward: Forward, observed: Observed, before: State, after: State, rows: IntArray
) -> FloatArray:
    """Return (P, 4) sums of squared errors before and after and of the noise variance, and their number, by press."""
    session = forward.session
    assert session.counts is not None
    of_test = (session.press >= 0) & observed.is_test[np.maximum(session.press, 0)]
    counts = np.where(of_test[:, None], session.counts, np.nan)
    (base, _), (named, noise) = (_squared_errors(forward, s, counts) for s in (before, after))
    errors = np.zeros((len(rows), 4))
    for k, p in enumerate(rows.tolist()):
        own = session.press == p
        errors[k] = [np.nansum(x[own]) for x in (base, named, noise)] + [np.isfinite(base[own]).sum()]
    return errors


def _excess_chi2(fitter: Fitter, state: State, rows: IntArray) -> FloatArray:
    """Return chi-square minus number of values (P,) of each press, nuisance parameters integrated out."""
    _, left = fitter.residual_blocks(state)
    return (left.chi - left.count)[np.isin(left.press, rows)]


def _closed_fraction(b: float, a: float, f: float, drawn: FloatArray) -> tuple[float, tuple[float, float]]:
    """Return the closed fraction of the gap and its 95 % interval, from sums of squares before, after and of noise."""
    if b <= f * (1 + 1e-9):
        return float("nan"), _NAN2
    resampled = (drawn[:, 0] - drawn[:, 1]) / np.maximum(drawn[:, 0] - drawn[:, 2], 1e-3 * (b - f))
    low, high = _interval95(resampled)
    closed = float((b - a) / (b - f))
    return closed, (min(low, closed), min(max(high, closed), 1.0) if closed <= 1 else closed)


def _interval95(values: FloatArray) -> tuple[float, float]:
    """Return the 2.5 % and 97.5 % quantiles."""
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def _rms_move_m(move: FloatArray) -> float:
    """Return the root mean square move of the contact positions [m]."""
    return float(np.sqrt((move[:, :2] ** 2).sum(axis=1).mean())) if len(move) else 0.0


def _squared_errors(forward: Forward, state: State, counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return squared errors and noise variances, both (N, J) [counts²]; NaN where nothing was read."""
    seen, noise, session = forward.predict(state), forward.noise, forward.session
    level = seen.values + state.rest
    mean, _ = noise.written(level)
    variance = noise.variance(forward.mean @ level, session.frames)
    if noise.force_n:
        # The measured force of a frame is noisy as well, which no model can follow.
        more = replace(state, move=state.move + np.array([0.0, 0.0, _FORCE_STEP]))
        slope = forward.mean @ (forward.predict(more).values - seen.values) / _FORCE_STEP
        force = np.maximum(session.mean_force(), 5 * noise.force_n)[:, None]
        variance = variance + (slope / force * noise.force_n) ** 2 / session.frames[:, None]
    error = (counts - forward.mean @ mean) ** 2
    return error, np.where(np.isfinite(error), variance, np.nan)
