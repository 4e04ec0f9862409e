"""Faults of single taxels that come and go: a level that steps and steps back, a taxel that sticks for a while.

Both are looked for about the best model, where that leaves more than chance, in a taxel's series of holds and rests.
A taxel sticks in a run of presses in which it reads one value while the model has it move. One that sticks away from
its level at rest, and answers again or stands at the end of the converter, is looked for beforehand, about the
calibration: a few of them draw every fit after them, and a level of its own would explain one. A step is a changepoint:
the window of presses in which a level of its own explains most of what the taxel's own curve leaves. The curve is
whatever effects can do smoothly: a nonlinear response, the same while the load falls, and slow drifts of level and
gain. The likelihood ratio, with the variance that the curve itself leaves, is asked to pass a bound for all windows and
taxels together.
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
"""Probability of a step in a session that has none, over all taxels and windows."""
FLAT, FAR, LIT, MOST = 4.0, 10.0, 0.3, 3
"""Noises within which a stuck taxel reads; noises and part of its top that it should move; steps a taxel may have."""
_EXPLAINED, _LEAST_BLOCKS, _KNOTS = 0.4, 2, 5
"""A step leaves no more than the rest of this of the squares: a smooth curve that the basis lacks leaves more."""


@dataclass(frozen=True, eq=False)
class Spell:
    """A taxel that is not itself for a while.

    Attributes:
        taxel: its column.
        blocks: keys of the presses and rests in which (:func:`block_keys`).
        press: row of the first press.
        begin_s: when it begins, after the session began [s]; NaN without a clock.
        end_s: when it ends [s]; NaN without a clock, infinite where it lasts to the end.
        lasts: whether it lasts to the end.
        counts: by how much the level steps; what it reads where it is stuck.
        stuck: whether the taxel does not answer.
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
    """(N,) keys of blocks: the row of a press, and -2 - row for the rest after it; -1 for the rest at the beginning."""
    last = np.maximum.accumulate(np.where(press >= 0, np.arange(len(press)), -1))
    before = np.where(last >= 0, press[np.maximum(last, 0)], -1)
    return np.where(press >= 0, press, np.where(before >= 0, -2 - before, -1))


def without_spells(session: GapSession, spells: Sequence[Spell]) -> GapSession:
    """The session with steps taken off, and nothing read while a taxel is stuck."""
    assert session.counts is not None
    counts, keys = session.counts.copy(), block_keys(session.press)
    for one in spells:
        rows = np.isin(keys, one.blocks)
        counts[rows, one.taxel] -= np.nan if one.stuck else one.counts
    return replace(session, counts=counts)


def find_spells(
    session: GapSession, fitter: Fitter, state: State, *, first: bool = False
) -> tuple[Spell, ...]:
    """All spells of a session, about a fit.

    Args:
        session: all that was read, in presses that are kept for the end as well.
        fitter: of it.
        state: the fit.
        first: whether the fit is a calibration's; of taxels that stick away from their level at rest alone.
    """
    forward = fitter.forward
    assert session.counts is not None
    # Forces as measured: those that fit best take up a part of what is looked for.
    state = replace(state, move=state.move * np.array([1.0, 1.0, 0.0]))
    if first:
        # One that sticks has next to no scale by a calibration that took it for dead.
        state = replace(state, log_s=np.maximum(state.log_s, np.median(state.log_s)))
    level = forward.predict(state).values + state.rest
    expected = forward.mean @ forward.noise.written(level)[0]
    variance = forward.noise.variance(forward.mean @ level, fitter.frames)
    ends = forward.noise.low, forward.noise.high
    # What effects do to a value taxel by taxel the curve of a taxel has, too; in the fit they may have followed a step.
    others = {n: v for n, v in state.effects.items() if effect(n).stage < Stage.CONVERTER}
    bare = forward.mean @ forward.predict(replace(state, effects=others)).values
    return spells_in(session, session.counts, expected, variance, bare, ends, first=first)


def spells_in(
    session: GapSession,
    counts: FloatArray,
    expected: FloatArray,
    variance: FloatArray,
    bare: FloatArray,
    ends: tuple[float, float] = (-np.inf, np.inf),
    *,
    first: bool = False,
) -> tuple[Spell, ...]:
    """All spells, about what a model expects.

    Args:
        session: presses, phases and times.
        counts: (N, J) what was read; NaN where nothing was.
        expected: (N, J) what a model expects.
        variance: (N, J) of the noise.
        bare: (N, J) what it expects above rest before anything acts on single values.
        ends: of the converter.
        first: whether the model is a calibration's; of taxels that stick away from their level at rest alone.
    """
    keys = block_keys(session.press)
    starts = np.flatnonzero(np.diff(keys, prepend=keys[0] - 1))
    own = np.flatnonzero(session.observation >= 0)
    time = np.full(len(session), np.nan)
    if session.samples.time_s is not None:
        time[session.observation[own][::-1]] = session.samples.elapsed_s[own][::-1]

    def spell(taxel: int, begin: int, end: int, height: float, *, stuck: bool) -> Spell:
        blocks = keys[starts[begin:end]]
        until = time[starts[end]] if end < len(starts) else np.inf
        first = int(blocks[blocks >= 0][0])
        lasts = end == len(starts)
        return Spell(taxel, blocks, first, float(time[starts[begin]]), float(until), lasts, height, stuck)

    found: list[Spell] = []
    counts = counts.copy()
    for j in range(counts.shape[1]):
        sd = np.sqrt(variance[:, j])
        for begin, end, at in _stuck(counts[:, j], expected[:, j], sd, keys, starts, ends, first=first):
            found.append(spell(j, begin, end, at, stuck=True))
            counts[np.isin(keys, found[-1].blocks), j] = np.nan
    if first:
        return tuple(found)
    series = _series(session, counts, bare, variance, starts)
    for j in range(counts.shape[1]):
        for begin, end, height in _steps(series, j, keys[starts] >= 0):
            found.append(spell(j, begin, end, height, stuck=False))
    return tuple(found)


def _stuck(
    y: FloatArray,
    expected: FloatArray,
    sd: FloatArray,
    keys: IntArray,
    starts: IntArray,
    ends: tuple[float, float],
    *,
    first: bool,
) -> list[tuple[int, int, float]]:
    """Runs of blocks [begin, end) in which a taxel reads one value and should not, with that value."""
    stops = np.append(starts[1:], len(y))
    flat = FLAT * float(np.median(sd))
    far = max(FAR * float(np.median(sd)), LIT * float(np.ptp(expected)))
    pressed = keys[starts] >= 0
    found, begin = list[tuple[int, int, float]](), 0
    while begin < len(starts):
        low, top, end = np.inf, -np.inf, begin
        while end < len(starts):
            part = y[starts[end] : stops[end]]
            least, most = (
                min(low, np.nanmin(part, initial=np.inf)),
                max(top, np.nanmax(part, initial=-np.inf)),
            )
            if most - least > flat:
                break
            low, top, end = least, most, end + 1
        level, run = 0.5 * (low + top), slice(starts[begin], stops[max(end - 1, begin)])
        off = np.abs(expected - level) > far
        away = sum(pressed[b] and off[starts[b] : stops[b]].any() for b in range(begin, end))
        # A taxel that reads its level at rest may be one that was missed: that needs one press more.
        missed = abs(level - float(expected.min())) <= flat
        later = starts[end] if end < len(starts) else len(y)
        answers = bool(pressed[end:].any()) and bool(np.isfinite(y[later:]).any())
        # What stands at an end of the converter is not read at all; elsewhere it may have died, which is an effect.
        ended = answers or (not missed and min(abs(level - x) for x in ends) < flat)
        if (
            away >= _LEAST_BLOCKS + missed
            and np.ptp(expected[run]) > far
            and ended
            and not (first and missed)
        ):
            # A press in which it begins or ends to stick is read in part.
            there = off & (np.abs(y - level) <= flat)
            earlier = begin - (begin > 0 and bool(there[starts[begin] - 1]))
            found.append((earlier, end + (end < len(starts) and bool(there[later])), level))
        begin = max(end, begin + 1)
    return found


@dataclass(frozen=True, eq=False)
class _Series:
    """Blocks: what was read (B, J), what was expected above rest, variances, whether the load fell, and time (B,)."""

    y: FloatArray
    x: FloatArray
    variance: FloatArray
    falling: BoolArray


def _series(
    session: GapSession, counts: FloatArray, bare: FloatArray, variance: FloatArray, starts: IntArray
) -> _Series:
    """Means over the hold of each press, and over each rest."""
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
    # What a press may err by beside the noise: its image, its force.
    return _Series(y, x, v + (C.image**2 + C.force**2) * x**2, falling)


def _steps(s: _Series, taxel: int, pressed: BoolArray) -> list[tuple[int, int, float]]:
    """Windows of blocks [begin, end) in which a taxel's level is another one, and by how much."""
    use = np.flatnonzero(np.isfinite(s.y[:, taxel]))
    if not len(use):
        return []
    y, x = s.y[use, taxel], s.x[use, taxel] / max(float(np.nanmax(s.x[:, taxel], initial=0.0)), 1e-12)
    weight = 1 / np.sqrt(np.maximum(s.variance[use, taxel], 1e-12))
    basis = _curves(x, s.falling[use], use / max(len(s.y) - 1, 1)) * weight[:, None]
    count, found = len(use), list[tuple[int, int, float]]()
    begun = np.concatenate([[0], np.cumsum(pressed[use])])
    left = weight * y
    for _ in range(MOST):
        u, size, _ = np.linalg.svd(basis, full_matrices=False)
        q = u[:, size > 1e-9 * size[0]]
        free = count - q.shape[1] - 1
        if free < 4:
            break
        rest = left - q @ (q.T @ left)
        pull = np.concatenate([[0.0], np.cumsum(weight * rest)])
        along = np.concatenate([np.zeros((1, q.shape[1])), np.cumsum(weight[:, None] * q, axis=0)])
        square = np.concatenate([[0.0], np.cumsum(weight**2)])
        share = np.einsum("ik,ik->i", along, along)
        curve = square[None] - square[:, None] - (share[None] + share[:, None] - 2 * along @ along.T)
        presses = begun[None] - begun[:, None]
        inside = (presses >= _LEAST_BLOCKS) & (presses <= begun[-1] - _LEAST_BLOCKS)
        inside &= curve > 1e-3 * np.maximum(square[None] - square[:, None], 1e-12)
        if not inside.any():
            break
        gain = np.where(inside, (pull[None] - pull[:, None]) ** 2 / np.where(inside, curve, 1.0), 0.0)
        begin, end = (int(k) for k in np.unravel_index(int(gain.argmax()), gain.shape))
        total, best = float(rest @ rest), float(gain[begin, end])
        if begin == 0:
            # A level that steps once is another one from then on.
            begin, end = end, count
        windows = int(inside.sum()) * s.y.shape[1]
        ratio = free * np.log(total / max(total - best, 1e-9 * total))
        # With the variance that is left, and with that of the model, whichever asks for more.
        if min(ratio, best) < 2 * np.log(windows / FALSE_ALARM) or best < _EXPLAINED * total:
            break
        column = np.zeros(count)
        column[begin:end] = 1.0
        basis = np.concatenate([basis, (weight * column)[:, None]], axis=1)
        found.append((begin, end, 0.0))
    if not found:
        return []
    # The curve and all steps together.
    own, *_ = np.linalg.lstsq(basis, left, rcond=None)
    heights = own[-len(found) :]
    edges = np.append(use, len(s.y))
    return [(int(edges[b]), int(edges[e]), float(h)) for (b, e, _), h in zip(found, heights, strict=True)]


def _curves(x: FloatArray, falling: BoolArray, time: FloatArray) -> FloatArray:
    """(B, n) what a taxel may do smoothly, of loads x and time in 0 to 1."""
    knots = np.concatenate([[0.0] * 3, np.linspace(0, 1, _KNOTS - 2), [1.0] * 3])
    splines = (
        BSpline.design_matrix(np.clip(time, 0.0, 1.0), knots, 3).toarray()
        if len(x) > 40
        else (np.stack([np.ones_like(time), time], axis=1))
    )
    columns = [splines, x[:, None], (x**2)[:, None], (x * time)[:, None]]
    if falling.any():
        columns.append(np.stack([np.ones_like(x), x, x**2], axis=1) * falling[:, None])
    return np.concatenate(columns, axis=1)
