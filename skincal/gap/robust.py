"""What must not sway a verdict: single glitch presses, taxels that die, and taxels that jump together.

All three are looked for about the fitted base model, and listed as what they are. A glitch press is left out. A taxel
that dies is a case of ``dead_taxel``, with the moment found by going through all presses. A jump of the level at rest
is allowed for, so that it is not taken for a drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from skincal.gap.reading import Reading
from skincal.inference.session import GapSession
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats

_GLITCH = 12.0
"""A glitch press has so many times the mean squared residual of all but the worst tenth of presses."""
_MOST_GLITCHES = 0.05
_DEAD = 0.3
"""A taxel that answers with less than this part is dead."""
_LIT_COUNTS = 15.0
SURE = 200.0
"""Fall of the squared residual that makes a dead taxel or a jump sure."""
_LEAST_JUMP = 1.5
_FEWEST = 8
_TAKEN = 0.5
"""What explains a press takes this part of its squared residual beyond noise."""
_MIXED = 3.0
"""Mean squared residual of an observation in which a jump happens, beside what it reads before and after."""
IN_PROPORTION = 3.0
"""A press that was left out fits as others do if it has no more than so many times the mean squared residual of all but
the worst tenth of presses."""
_OTHERS = 16.0
"""A press differs if its squared residual is so many standard deviations beyond that of noise: of three hundred values
more than twice as large."""
_MOST_DOMINATING, _FAR_BEYOND, _MUCH_OF_ALL = 2, 3.0, 0.15
"""Presses that dominate: so many at most, so far beyond the worst tenth, and with so much of what all presses leave."""


@dataclass(frozen=True)
class Dead:
    """A taxel that does not answer.

    Attributes:
        taxel: its column.
        from_s: since when, after the session began [s]; 0 for always.
        stuck_counts: what it reads.
        answer: part of the value that still shows.
    """

    taxel: int
    from_s: float
    stuck_counts: float
    answer: float


@dataclass(frozen=True)
class Jump:
    """Taxels whose level at rest jumps at one moment.

    Attributes:
        taxels: their columns.
        at_s: when, after the session began [s].
        counts: by how much each jumps.
        until_s: when they jump back [s].
        about_s: between these it may have happened: what was read there is the mean of before and after [s].
    """

    taxels: tuple[int, ...]
    at_s: float
    counts: tuple[float, ...]
    until_s: float = float("inf")
    about_s: tuple[float, float] | None = None


def glitches(residual: FloatArray, seen: BoolArray, press: IntArray) -> IntArray:
    """Rows of presses whose residual is out of all proportion to that of the others; none where they are many.

    Args:
        residual: (N, J) whitened, of a fitted model.
        seen: (N, J) where something was read.
        press: (N,) row of the press of each observation.
    """
    rows, squares, read = _by_press(residual, seen, press)
    wild = _wild(squares, read)
    few = len(rows) >= _FEWEST and wild.sum() <= max(1, _MOST_GLITCHES * len(rows))
    return rows[wild] if few else rows[:0]


def too_many(residual: FloatArray, seen: BoolArray, press: IntArray) -> IntArray:
    """Rows of presses that are out of all proportion, where they are too many to be glitches; arguments as above."""
    rows, squares, read = _by_press(residual, seen, press)
    some = read > 0
    rows, squares, read = rows[some], squares[some], read[some]
    wild = rows[_wild(squares, read)] if len(rows) else rows
    return wild if len(wild) > max(1, _MOST_GLITCHES * len(rows)) else wild[:0]


def of_neither(before: FloatArray, after: FloatArray, seen: BoolArray, press: IntArray) -> IntArray:
    """Rows of presses that are out of all proportion to what a better model leaves of the others, under both models.

    A glitch hides where a model leaves much of every press. One that only the better model fails at is no glitch.

    Args:
        before: (N, J) whitened residual of a model.
        after: the same of a better one.
        seen: (N, J) where something was read.
        press: (N,) row of the press of each observation.
    """
    rows, first, read = _by_press(before, seen, press)
    _, last, _ = _by_press(after, seen, press)
    some = read > 0
    rows, first, last, read = rows[some], first[some], last[some], read[some]
    wild = _wild(last, read)
    if len(rows) < _FEWEST or wild.sum() > max(1, _MOST_GLITCHES * len(rows)):
        return rows[:0]
    usual = last[~wild] / read[~wild]
    least = _GLITCH * max(1.0, float(np.quantile(usual, 0.9)) if len(usual) else 0.0)
    return rows[wild & (first > least * read)]


def _wild(squares: FloatArray, read: FloatArray, times: float = _GLITCH) -> BoolArray:
    """Presses whose mean square is out of all proportion."""
    mean = squares / np.maximum(read, 1)
    return mean > times * max(1.0, float(np.quantile(mean, 0.9)) if len(mean) else 0.0)


def explained(
    before: FloatArray, after: FloatArray, seen: BoolArray, press: IntArray, doubted: IntArray
) -> bool:
    """Whether all of some presses are no glitches under a model.

    They are not if it takes most of what another one leaves of them, and if they are in proportion with others then.

    Args:
        before: (N, J) whitened residual of the other model.
        after: the same of the model.
        seen: (N, J) where something was read.
        press: (N,) row of the press of each observation.
        doubted: rows of the presses; those of which nothing was read do not count.
    """
    rows, _, read = _by_press(before, seen, press)
    own = np.isin(rows, doubted) & (read > 0)
    return bool(np.isin(rows[own], explained_presses(before, after, seen, press, doubted)).all())


def explained_presses(
    before: FloatArray,
    after: FloatArray,
    seen: BoolArray,
    press: IntArray,
    doubted: IntArray,
    times: float = _GLITCH,
) -> IntArray:
    """Rows of those presses that are no glitches under a model; the arguments are those of :func:`explained`.

    With ``times`` a press may have no more than so many times what the worst tenth of all presses has.
    """
    rows, first, read = _by_press(before, seen, press)
    _, last, _ = _by_press(after, seen, press)
    own = np.isin(rows, doubted) & (read > 0)
    taken = first - last >= _TAKEN * (first - read)
    return rows[own & taken & ~_wild(last, read, times)]


def dominating(residual: FloatArray, seen: BoolArray, press: IntArray) -> IntArray:
    """Rows of the presses, one or two, that hold much of what all presses leave beyond noise.

    One press is no evidence: at the border of the patch, or where a place was read from the wrong side of a taxel, a
    single press differs by more than a weak effect does in all others together.

    Args:
        residual: (N, J) whitened, of a fitted model.
        seen: (N, J) where something was read.
        press: (N,) row of the press of each observation.
    """
    rows, squares, read = _by_press(residual, seen, press)
    if len(rows) < _FEWEST:
        return rows[:0]
    excess = squares - read
    usual = max(0.0, float(np.quantile(excess, 0.9)))
    whole = float(np.maximum(excess, 0.0).sum())
    most = np.argsort(-excess)[:_MOST_DOMINATING]
    much = max(SURE, _FAR_BEYOND * usual, _MUCH_OF_ALL * whole)
    return np.sort(rows[most[excess[most] > much]])


def others_differ(residual: FloatArray, seen: BoolArray, press: IntArray) -> bool:
    """Whether any press that was kept differs by far more than noise.

    Where glitches were left out and all others fit, they were that. Where others differ as well, if less, those that
    were left out may be the ones that show an effect best.

    Args:
        residual: (N, J) whitened, of a fitted model; what may be off in sensor, places and law projected out.
        seen: (N, J) where something was read; nowhere in what was left out.
        press: (N,) row of the press of each observation.
    """
    _, squares, read = _by_press(residual, seen, press)
    return bool((squares - read > _OTHERS * np.sqrt(2 * read)).any())


def _by_press(
    residual: FloatArray, seen: BoolArray, press: IntArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Rows of the presses (P,), the sum of squares of each and how many values were read of it."""
    pressed = press >= 0
    rows, owner = np.unique(press[pressed], return_inverse=True)
    squares = np.bincount(owner, (residual[pressed] ** 2).sum(axis=1), len(rows))
    read = np.bincount(owner, seen[pressed].sum(axis=1), len(rows))
    return rows, as_floats(squares), as_floats(read)


def dead_taxels(values: FloatArray, reading: Reading, session: GapSession) -> list[Dead]:
    """Taxels that do not follow the model at all from some moment on.

    Args:
        values: (N, J) of a fitted model [counts].
        reading: what was read.
        session: gives times and presses.
    """
    expected, spread = reading.expected(values), reading.deviation(values)
    time = times(session)
    starts = _press_starts(session)
    found: list[Dead] = []
    for taxel in range(values.shape[1]):
        y, x = reading.counts[:, taxel], expected[:, taxel]
        # A press beyond the rim of a mesh has no image.
        ok = reading.seen[:, taxel] & np.isfinite(x)
        best = (SURE, None)
        for begin in [0, *starts[1 :: max(1, len(starts) // 30)]]:
            rows = np.flatnonzero(ok & (np.arange(len(y)) >= begin))
            lit = x[rows] > _LIT_COUNTS + min(0.0 if not len(rows) else float(x[rows].min()), _LIT_COUNTS)
            if len(np.unique(session.press[rows][lit])) < 3:
                continue
            weight = 1 / spread[rows, taxel] ** 2
            answer, level = _line(x[rows], y[rows], weight)
            after = (weight * (y[rows] - answer * x[rows] - level) ** 2).sum()
            fall = float((weight * (y[rows] - x[rows]) ** 2).sum() - after)
            if fall > best[0] and answer < _DEAD:
                since = float(time[begin]) if begin else 0.0
                best = (fall, Dead(taxel, since, level / max(1 - answer, 0.1), max(answer, 0.0)))
        if best[1] is not None:
            found.append(best[1])
    return found if len(found) <= values.shape[1] // 3 else []


def _line(x: FloatArray, y: FloatArray, weight: FloatArray) -> tuple[float, float]:
    """Slope and offset of a weighted straight line."""
    total = weight.sum()
    mx, my = float((weight * x).sum() / total), float((weight * y).sum() / total)
    curve = float((weight * (x - mx) ** 2).sum())
    slope = float((weight * (x - mx) * (y - my)).sum()) / curve if curve > 0 else 1.0
    return slope, my - slope * mx


def jumps(values: FloatArray, reading: Reading, session: GapSession, dead: list[Dead]) -> list[Jump]:
    """Jumps of the level at rest that a slow drift does not explain.

    Args:
        values: (N, J) of a fitted model [counts].
        reading: what was read.
        session: gives times, and where nothing touches.
        dead: taxels that are not looked at.
    """
    rest = np.flatnonzero(session.press < 0)
    if len(rest) < 2 * _FEWEST:
        return []
    residual, weight = reading.residual(values), reading.weight(values)
    found: dict[int, list[int]] = {}
    for taxel in sorted(set(range(values.shape[1])) - {d.taxel for d in dead}):
        rows = rest[weight[rest, taxel] > 0]
        if len(rows) < 2 * _FEWEST:
            continue
        step = _step(residual[rows, taxel], weight[rows, taxel])
        if step is not None and abs(step[1]) >= _LEAST_JUMP:
            found.setdefault(int(rows[step[0]]), []).append(taxel)
    return [_jump(row, taxels, values, reading, session) for row, taxels in _together(found)]


def _step(r: FloatArray, w: FloatArray) -> tuple[int, float] | None:
    """Where a step is, and how high, if it beats a straight line and a curve by far; None else."""
    total = float((r**2).sum())
    share = np.linspace(-1.0, 1.0, len(r))
    slow = w[:, None] * np.stack([np.ones_like(share), share, share**2, share**3], axis=1)
    drift = float((r @ np.linalg.qr(slow)[0]) @ (r @ np.linalg.qr(slow)[0]))
    best = (0.0, 0, 0.0)
    pull, curve = np.cumsum((r * w)[::-1])[::-1], np.cumsum((w**2)[::-1])[::-1]
    for k in range(3, len(r) - 3):
        # Levels before and after are both free: what differs is the step.
        first = np.array([pull[0] - pull[k], curve[0] - curve[k]])
        fall = first[0] ** 2 / max(first[1], 1e-12) + pull[k] ** 2 / max(curve[k], 1e-12)
        if fall > best[0]:
            best = (float(fall), k, float(pull[k] / curve[k] - first[0] / max(first[1], 1e-12)))
    left_by_step, left_by_drift = total - best[0], total - drift
    sure = best[0] > SURE and left_by_drift - left_by_step > SURE
    return (best[1], best[2]) if sure and left_by_step < 0.5 * left_by_drift else None


def _together(found: dict[int, list[int]]) -> list[tuple[int, list[int]]]:
    """Rows and taxels of jumps: those within a few observations of each other are one."""
    groups: list[tuple[int, list[int]]] = []
    for row in sorted(found):
        if groups and row - groups[-1][0] <= 6:
            groups[-1][1].extend(found[row])
        else:
            groups.append((row, list(found[row])))
    return groups


def _jump(row: int, taxels: list[int], values: FloatArray, reading: Reading, session: GapSession) -> Jump:
    """A jump that shows at rest from a row on: how high it is, and when within the press before it was."""
    rest = np.flatnonzero(session.press < 0)
    before, after = rest[rest < row], rest[rest >= row]
    between: IntArray = np.arange(int(before[-1]), min(int(after[0]) + 2, len(session)))
    height = _height(values, reading, before, after, taxels)
    shifts = np.zeros(1), height
    stay, moved = (
        (reading.residual(values + shift)[between][:, taxels] ** 2).mean(axis=1) for shift in shifts
    )
    k = int(np.argmin([stay[:k].sum() + moved[k:].sum() for k in range(len(between))]))
    # The observation in which it happens is a mean of both levels, and says nothing of either.
    mixed = [int(between[n]) for n in (k - 1, k) if n >= 0 and (stay if n < k else moved)[n] > _MIXED]
    height = _height(values, reading, np.setdiff1d(before, mixed), np.setdiff1d(after, mixed), taxels)
    time, first = times(session), int(between[k])
    about = float(time[max(0, first - 2)]), float(time[min(len(time) - 1, first + 1)])
    return Jump(tuple(taxels), float(time[first]), tuple(height[taxels].tolist()), about_s=about)


def _height(
    values: FloatArray, reading: Reading, before: IntArray, after: IntArray, taxels: list[int]
) -> FloatArray:
    """By how much some taxels (J,) read higher in some rows than in others before [counts]."""
    height = np.zeros(values.shape[1])
    for j in taxels:
        height[j] = _level(values, reading, after, j) - _level(values, reading, before, j)
    return height


def _level(values: FloatArray, reading: Reading, rows: IntArray, taxel: int) -> float:
    """By how much a taxel reads higher than its values in some rows [counts].

    A converter clips: what it shows of a level near a bound is not the level. Of one below the bound it shows next to
    nothing, so that it is taken to be no further away than the noise.
    """
    rows = rows[reading.seen[rows, taxel]]
    share = reading.frames[rows] / reading.frames[rows].sum()
    shown = float(share @ reading.counts[rows, taxel])
    own, bound = values[rows, taxel] + reading.lift[rows, taxel], reading.readout.value_min
    noise = float(reading.sigma_counts[taxel])
    most = float(np.abs(shown - own).max()) + 10 * noise
    least = -most if bound is None else bound - noise - float(own.max())

    def over(offset: float) -> float:
        return float(share @ reading.expected_of(taxel, own + offset)) - shown

    if over(least) >= 0 or over(most) <= 0:
        return least if over(least) >= 0 else most
    return float(brentq(over, least, most, xtol=1e-4))


def without_jumps(reading: Reading, session: GapSession, jumped: list[Jump]) -> Reading:
    """The reading with jumps allowed for: what is expected jumps as well, and is not trusted while it may do so."""
    lift, time = np.zeros_like(reading.trust), times(session)
    for jump in jumped:
        later = (time >= jump.at_s) & (time < jump.until_s)
        for taxel, height in zip(jump.taxels, jump.counts, strict=True):
            lift[later, taxel] += height
    return without_mixed(reading.lifted(lift), session, jumped)


def without_mixed(reading: Reading, session: GapSession, jumped: Sequence[Jump]) -> Reading:
    """The reading without what taxels read while they may jump, a mean of before and after."""
    trust, time = np.ones_like(reading.trust), times(session)
    for jump in jumped:
        if jump.about_s is not None:
            rows = np.flatnonzero((time > jump.about_s[0]) & (time < jump.about_s[1]))
            trust[np.ix_(rows, np.array(jump.taxels))] = 0.0
    return reading.trusting(trust)


def without_presses(reading: Reading, press: IntArray, rows: IntArray) -> Reading:
    """The reading without some presses."""
    return reading.trusting(np.where(np.isin(press, rows), 0.0, 1.0)[:, None])


def with_presses(reading: Reading, press: IntArray, rows: IntArray) -> Reading:
    """The reading with some presses that had been left out."""
    again = np.isin(press, rows)[:, None] & np.isfinite(reading.counts)
    return replace(reading, trust=np.where(again, 1.0, reading.trust))


def times(session: GapSession) -> FloatArray:
    """(N,) time of each observation after the session began [s]; its number where there is no clock."""
    samples = session.samples
    if samples.time_s is None:
        return np.arange(len(session), dtype=np.float64)
    total = np.bincount(
        session.observation[session.observation >= 0],
        samples.elapsed_s[session.observation >= 0],
        len(session),
    )
    return total / np.bincount(session.observation[session.observation >= 0], minlength=len(session))


def _press_starts(session: GapSession) -> list[int]:
    """The first observation of each press, in the order of time."""
    change = np.flatnonzero(np.diff(session.press, prepend=-2) != 0)
    return [int(i) for i in change if session.press[i] >= 0]
