"""Faults that come and go under load: taxels stuck at a bound for a while, and levels that jump where nothing rests.

A session with rest between its presses shows a jump at rest (:mod:`skincal.gap.robust`). On a staircase of pressure
nothing rests until the end; there the level is looked for beside the taxel's own curve, and a group of taxels that
jumps at one moment is believed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.gap.reading import Reading
from skincal.gap.robust import Jump, times
from skincal.inference.session import GapSession
from skincal.model.arrays import FloatArray, IntArray

_FAR_COUNTS = 20.0
_FAR_SIGMA = 10.0
"""A bound so far from what is expected is not where a working taxel would be."""
_AT_BOUND = 0.05
_LEAST = 2
"""Presses in which a taxel sticks, or its level is another one."""
_RARE = 0.25
"""Rest counts as rare where fewer than so many presses in one are followed by it."""
_LEAST_GROUP = 3
_LEAST_COUNTS = 5.0
_SHARE_LEFT = 0.6
"""A jump leaves no more of the squared residual than this."""


@dataclass(frozen=True)
class Stuck:
    """A taxel that reads a bound of the converter for a while.

    Attributes:
        taxel: its column.
        from_s: since when, after the session began [s].
        until_s: until when [s].
        counts: the bound.
    """

    taxel: int
    from_s: float
    until_s: float
    counts: float


def stuck_taxels(values: FloatArray, reading: Reading, session: GapSession) -> list[Stuck]:
    """Taxels that sit at a bound while they should be far from it, and answer again later.

    One that stays there to the end is dead (:func:`skincal.gap.robust.dead_taxels`), and not looked at here.

    Args:
        values: (N, J) of a fitted model [counts].
        reading: what was read.
        session: gives times and presses.
    """
    expected, time = reading.expected(values), times(session)
    far = np.maximum(_FAR_COUNTS, _FAR_SIGMA * reading.sigma_counts)
    found: list[Stuck] = []
    for bound in (reading.readout.value_min, reading.readout.value_max):
        if bound is None:
            continue
        at = (np.abs(reading.counts - bound) < _AT_BOUND) | ~reading.seen
        astray = (np.abs(expected - bound) > far) & reading.seen
        there = at & astray & (session.press >= 0)[:, None]
        for taxel in np.flatnonzero(there.any(axis=0)).tolist():
            rows = np.flatnonzero(there[:, taxel])
            presses = np.unique(session.press[rows])
            whole = at[rows[0] : rows[-1] + 1, taxel].all()
            again = (astray & ~at)[rows[-1] + 1 :, taxel].any()
            if len(presses) < _LEAST or not whole or not again:
                continue
            # The observations before and after may have seen a part of it.
            ends = time[[max(0, rows[0] - 1), min(rows[-1] + 1, len(time) - 1)]].tolist()
            found.append(Stuck(taxel, ends[0], ends[1], float(bound)))
    return found


def without_stuck(reading: Reading, session: GapSession, stuck: list[Stuck]) -> Reading:
    """The reading with no trust in taxels while they were stuck."""
    trust, time = np.ones_like(reading.trust), times(session)
    for one in stuck:
        trust[(time >= one.from_s) & (time <= one.until_s), one.taxel] = 0.0
    return reading.trusting(trust)


def rests_rarely(session: GapSession) -> bool:
    """Whether most presses follow one another without rest, as plateaus of a staircase do."""
    own = session.press[np.flatnonzero(np.diff(session.press, prepend=-2) != 0)]
    pressed = int((own >= 0).sum())
    return pressed > 0 and int((own < 0).sum()) < _RARE * pressed


def jumps_under_load(values: FloatArray, reading: Reading, session: GapSession) -> list[Jump]:
    """Groups of taxels whose level jumps at the beginning of a press, beside curves of their own.

    Args:
        values: (N, J) of a fitted model [counts].
        reading: what was read.
        session: gives times and presses.
    """
    new = np.diff(session.press, prepend=-2) != 0
    starts, begun = np.flatnonzero(new)[1:], np.concatenate([[0], np.cumsum(new & (session.press >= 0))])
    expected, weight = reading.expected(values), 1 / reading.deviation(values)
    found: dict[tuple[int, int], list[tuple[int, float]]] = {}
    for taxel in range(values.shape[1]):
        use = reading.seen[:, taxel]
        if use.sum() < 4 * _LEAST_GROUP:
            continue
        step = _window(reading.counts[:, taxel], expected[:, taxel], weight[:, taxel] * use, starts, begun)
        if step is not None:
            found.setdefault(step[:2], []).append((taxel, step[2]))
    time = times(session)
    return [
        Jump(
            tuple(t for t, _ in group),
            float(time[begin]),
            tuple(height for _, height in group),
            float(time[end]) if end < len(time) else float("inf"),
        )
        for (begin, end), group in sorted(found.items())
        if len(group) >= _LEAST_GROUP
    ]


def _window(
    y: FloatArray, x: FloatArray, weight: FloatArray, starts: IntArray, begun: IntArray
) -> tuple[int, int, float] | None:
    """Where a level is another one, from an observation to before another, and by how much; None for nowhere.

    Args:
        y: (N,) what was read.
        x: (N,) what was expected.
        weight: (N,) what a count is worth.
        starts: observations with which something new begins, a press or rest.
        begun: (N + 1,) how many presses have begun before each observation.
    """
    y, x = np.nan_to_num(y), x / max(float(x.max(initial=0.0)), 1e-12)
    # A curve, and another one once the load falls: neither a law that is not linear nor memory is a jump.
    rising = np.stack([np.ones_like(x), x, x**2], axis=1)
    falling = rising * (np.arange(len(x)) > int(x.argmax()))[:, None]
    own = np.concatenate([rising, falling], axis=1) * weight[:, None]
    basis = np.linalg.qr(own)[0]
    left = weight * y - basis @ (basis.T @ (weight * y))
    total, best = float(left @ left), (0.0, 0, 0, 0.0)
    ends = [*starts.tolist(), len(y)]
    # Sums of the step over what the curves leave of it, from sums up to each observation.
    pull = np.concatenate([[0.0], np.cumsum(weight * left)])
    share = np.concatenate([np.zeros((1, basis.shape[1])), np.cumsum(weight[:, None] * basis, axis=0)])
    count = np.concatenate([[0.0], np.cumsum(weight**2)])
    for i, begin in enumerate(ends[:-1]):
        for end in ends[i + 1 :]:
            along = share[end] - share[begin]
            curve = float(count[end] - count[begin] - along @ along)
            if curve <= 1e-3 * (count[end] - count[begin]):
                continue
            height = float(pull[end] - pull[begin]) / curve
            fall = height**2 * curve
            if fall > best[0]:
                best = (fall, begin, end, height)
    if begun[best[2]] - begun[best[1]] < _LEAST:
        # One press that is off by itself is a glitch.
        return None
    if abs(best[3]) < _LEAST_COUNTS or total - best[0] > _SHARE_LEFT * total:
        return None
    return best[1], best[2], best[3]
