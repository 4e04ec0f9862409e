"""How much of the gap is gone, on presses that neither the fit nor the choice has seen; they are looked at once.

Before and after are compared frame by frame, with measured counts as they are and predictions as the converter shows
them on average. A press may place itself within its slack, alike before and after; one that is out of all proportion
both times is left out. The floor is the noise at the values that are predicted, and no more than what the better of the
two models leaves: an error below it shows that it is less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from skincal.diagnosis.observed import Observed, full_rate
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitter
from skincal.inference.forward import Forward, State
from skincal.inference.start import better_placement, candidate_placements, outlier_presses
from skincal.model.arrays import FloatArray, IntArray

_DRAWS, _STEPS = 400, 8


@dataclass(frozen=True, eq=False)
class Gap:
    """The gap on presses nobody has fitted.

    Attributes:
        before: root mean square error of a taxel with the base model [counts].
        after: with the named effects [counts].
        floor: noise alone [counts].
        closed: (before² - after²) / (before² - floor²); NaN where there is no gap.
        interval: where ``closed`` lies, 95 %.
        added: where after² - before² lies, 95 % [counts²].
        kept: where what is left of the gap, beyond the part that must be closed, lies, 95 %: in squares over the noise,
            with all that a press has for itself integrated out, as the model has it.
        presses: rows of the presses looked at.
        frames: number of frames, or of hold means.
        slack_before_m: root mean square of what presses had to move [m].
        slack_after_m: with the named effects [m].
        errors: (presses, 4) sums of squares before, after and of the floor, and their number, press by press.
    """

    before: float
    after: float
    floor: float
    closed: float
    interval: tuple[float, float]
    added: tuple[float, float]
    kept: tuple[float, float]
    presses: IntArray
    frames: int
    slack_before_m: float
    slack_after_m: float
    errors: FloatArray

    @property
    def refutes(self) -> bool:
        """Whether presses are surely further off after than before, or what was missing has more than doubled."""
        return self.added[0] > 0 or self.closed < -1

    @property
    def stays(self) -> bool:
        """Whether most of it surely stays: what is named does not explain what is missing.

        In squares, not in parts of the gap: of a gap that is hardly there any part may seem to stay. And over what an
        image may err by: that stays, whatever is named.
        """
        return self.kept[0] > 0


def placed_presses(fitter: Fitter, state: State, rows: IntArray, others: Sequence[State] = ()) -> State:
    """A state whose named presses stand where they fit best, within the slack and what is known of it; all else held.

    Args:
        fitter: of the session, these presses among them.
        state: of all else.
        rows: of the presses.
        others: states whose places are tried, too.
    """
    plain = Fitter(fitter.forward, fitter.counts, replace(fitter.priors, image=0.0, errs=False))
    begin = candidate_placements(fitter, state, rows)
    tried = [*(begin or [state]), *(replace(state, move=one.move) for one in others)]
    best = reduce(better_placement, (plain.profile_presses(x, _STEPS, rows) for x in tried)).state.move
    move = state.move.copy()
    move[rows] = best[rows]
    return replace(state, move=move)


def gap_of(observed: Observed, before: State, after: State, rng: np.random.Generator) -> Gap:
    """Looks at the presses of the end.

    Args:
        observed: the session.
        before: the base model's fit.
        after: with the named effects; the same where none are.
        rng: draws whole presses again, for intervals.
    """
    rows = np.flatnonzero(observed.held)
    fitter = observed.whole()
    whole = full_rate(observed)
    first = placed_presses(fitter, before, rows)
    if after is before:
        second = first
    else:
        # A press may be trapped at one place before and at another after: each model has both to choose from.
        second = placed_presses(fitter, after, rows, [first])
        first = placed_presses(fitter, before, rows, [second])
    # An image out of all proportion by either model is a fault of its press, and says nothing of models.
    wild = np.intersect1d(outlier_presses(fitter, first), outlier_presses(fitter, second))
    rows = np.setdiff1d(rows, wild)
    frames = _frames(whole, observed)
    (base, _), (named, noise) = (_squares(whole, s, frames) for s in (first, second))
    owner = whole.session.press
    errors = np.zeros((len(rows), 4))
    for k, p in enumerate(rows.tolist()):
        mine = owner == p
        errors[k] = [np.nansum(x[mine]) for x in (base, named, noise)] + [np.isfinite(base[mine]).sum()]
    errors = errors[errors[:, 3] > 0]
    if not len(errors):
        nothing = (float("nan"), float("nan"))
        return Gap(0.0, 0.0, 0.0, float("nan"), nothing, nothing, nothing, rows, 0, 0.0, 0.0, errors)
    b, a, f, n = errors.sum(axis=0)
    scale = min(1.0, min(a, b) / f) if f > 0 else 1.0
    errors[:, 2] *= scale
    f *= scale
    drawn = errors[rng.integers(0, len(errors), (_DRAWS, len(errors)))].sum(axis=1)
    added = (drawn[:, 1] - drawn[:, 0]) / drawn[:, 3]
    kept = _beyond(fitter, second, rows) - (1 - C.closes) * _beyond(fitter, first, rows)
    kept = kept[rng.integers(0, len(kept), (_DRAWS, len(kept)))].sum(axis=1)
    return Gap(
        float(np.sqrt(b / n)), float(np.sqrt(a / n)), float(np.sqrt(f / n)), *_closed(b, a, f, drawn),
        _ends(added), _ends(kept), rows, int(n // whole.layout.taxels),
        _rms(first.move[rows]), _rms(second.move[rows]), errors,
    )  # fmt: skip


def _beyond(fitter: Fitter, state: State, rows: IntArray) -> FloatArray:
    """(P,) squares over the noise that presses leave beyond their number, nuisances integrated out."""
    _, left = fitter.residual_blocks(state)
    return (left.chi - left.count)[np.isin(left.press, rows)]


def _closed(b: float, a: float, f: float, drawn: FloatArray) -> tuple[float, tuple[float, float]]:
    if b <= f * (1 + 1e-9):
        return float("nan"), (float("nan"), float("nan"))
    each = (drawn[:, 0] - drawn[:, 1]) / np.maximum(drawn[:, 0] - drawn[:, 2], 1e-3 * (b - f))
    low, high = _ends(each)
    closed = float((b - a) / (b - f))
    return closed, (min(low, closed), min(max(high, closed), 1.0) if closed <= 1 else closed)


def _ends(values: FloatArray) -> tuple[float, float]:
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def _rms(move: FloatArray) -> float:
    return float(np.sqrt((move[:, :2] ** 2).sum(axis=1).mean())) if len(move) else 0.0


def _frames(whole: Forward, observed: Observed) -> FloatArray:
    """(N, J) counts of the presses of the end while they touch, else NaN."""
    s = whole.session
    assert s.counts is not None
    own = (s.press >= 0) & observed.held[np.maximum(s.press, 0)]
    return np.where(own[:, None], s.counts, np.nan)


def _squares(whole: Forward, state: State, counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squared errors (N, J), and the noise's variance."""
    seen = whole.predict(state)
    level = seen.values + state.rest
    mean, _ = whole.noise.written(level)
    variance = whole.noise.variance(whole.mean @ level, whole.session.frames)
    if whole.noise.force_n:
        # The measured force of a frame is noisy, too: no model can follow that.
        more = replace(state, move=state.move + np.array([0.0, 0.0, 0.02]))
        per_n = whole.mean @ (whole.predict(more).values - seen.values) / 0.02
        force = np.maximum(whole.session.mean_force(), 5 * whole.noise.force_n)[:, None]
        variance = variance + (per_n / force * whole.noise.force_n) ** 2 / whole.session.frames[:, None]
    error = (counts - whole.mean @ mean) ** 2
    return error, np.where(np.isfinite(error), variance, np.nan)
