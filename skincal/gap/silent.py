"""Taxels that fall silent late, so that one press shows it, or a few.

A press over a taxel that has just died fits nowhere; where it is the only one, or one of few, it looks like a glitch.
It is none if its image is right once that one taxel is not looked at, but no other force makes it so, and if the taxel
answered before and no later press shows it answering.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.gap.hypothesis import Hypothesis
from skincal.gap.problem import RefitOptions, cost_of_presses
from skincal.gap.reading import Reading
from skincal.gap.relocate import of_presses, relocated
from skincal.gap.robust import SURE, Dead, times
from skincal.gap.session import GapSession
from skincal.gap.settle import settled
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats

_SILENT = 0.2
"""A taxel that reads less than this part of what it should is silent."""
_FAINT_COUNTS = 4.0
"""Silence begins where a taxel should read so much, once it is sure that there is any."""
_SIGMA = 5.0
"""Noise that lifts the reading of a silent taxel is no answer."""
_TAKEN = 0.8
"""A press is explained by a silent taxel that takes this part of what it leaves beyond the usual."""
_RATHER = 50.0
"""A silent taxel explains a press rather than a force that may be anything does, if it leaves so much less of it."""
_STEPS = 4
_ANY_FORCE = 0.5
"""Relative standard deviation of a force that may be anything."""
_FEW = 8
"""Presses in which a taxel might be silent; one that is in more is found by :func:`skincal.gap.robust.dead_taxels`."""
_MOST = 3
"""No more taxels than one in so many fall silent; where they do, it is something else."""


@dataclass(frozen=True, eq=False)
class Silent:
    """A taxel that was seen to fall silent.

    Attributes:
        dead: the taxel, since when, and what it reads.
        between_s: it was heard before the first time, and silent from the second one on [s].
        presses: rows of the presses that show it.
        left: (P,) what each of them costs without the taxel's silence.
        fall: by how much that is less than with it, all together.
        share: the part of what they cost beyond the usual that this is.
    """

    dead: Dead
    between_s: tuple[float, float]
    presses: IntArray
    left: FloatArray
    fall: float
    share: float


def silent_taxels(
    found: Hypothesis,
    session: GapSession,
    reading: Reading,
    options: RefitOptions,
    doubted: IntArray,
    dead: Sequence[Dead] = (),
) -> list[Silent]:
    """Taxels that fall silent in one press or a few, and are not heard of again.

    Args:
        found: a fit of the base model.
        session: what was pressed.
        reading: of all presses.
        options: priors of places.
        doubted: rows of presses that the fit did not learn from, so that they have no places yet.
        dead: taxels that are known to be dead; not looked at.
    """
    if not options.base:
        return []
    if len(doubted):
        found = relocated(found, *of_presses(session, reading, doubted), options)
    here = _settled(found, session, reading, options, doubted)
    values = here.values(session)
    costs = cost_of_presses(here, reading.residual(values), session, options)
    measured = here.with_places(np.zeros_like(here.places)).values(session)
    found_silent: list[Silent] = []
    for taxel in sorted(set(range(values.shape[1])) - {one.taxel for one in dead}):
        might = [
            row
            for row in np.flatnonzero(costs > _usual(costs, session) + SURE).tolist()
            if len(_silence(measured[:, taxel], reading, session, row, taxel))
        ]
        if 0 < len(might) <= _FEW:
            one = _heard_no_more(here, session, reading, options, taxel, np.array(might), values, costs)
            found_silent += [] if one is None else [one]
    best = _best_of_each_press(found_silent)
    return best if len(best) <= values.shape[1] // _MOST else []


def _best_of_each_press(silent: Sequence[Silent]) -> list[Silent]:
    """Those that explain a press better than any other does, which may explain it as well from another place."""
    least: dict[int, float] = {}
    for one in silent:
        for row, left in zip(one.presses.tolist(), one.left.tolist(), strict=True):
            least[row] = min(left, least.get(row, np.inf))
    return [one for one in silent if all(one.left <= [least[row] for row in one.presses.tolist()])]


def _settled(
    found: Hypothesis, session: GapSession, reading: Reading, options: RefitOptions, rows: IntArray
) -> Hypothesis:
    """The hypothesis with some presses at their best places."""
    if not len(rows):
        return found
    end, _ = settled(found, *of_presses(session, reading, rows), options, _STEPS)
    own = np.isin(np.arange(len(found.places)), rows)
    return found.with_places(np.where(own[:, None], end.places, found.places))


def _usual(costs: FloatArray, session: GapSession) -> float:
    """What presses cost usually."""
    return float(np.nanmedian(costs[np.unique(session.press[session.press >= 0])]))


def _silence(expected: FloatArray, reading: Reading, session: GapSession, press: int, taxel: int) -> IntArray:
    """The observations of a press in which a taxel is silent to the end, if some show it that it should not be."""
    rows = np.flatnonzero((session.press == press) & reading.seen[:, taxel])
    rows = rows[expected[rows] > _FAINT_COUNTS]
    heard = np.flatnonzero(_heard(expected[rows], reading, rows, taxel))
    rows = rows[heard[-1] + 1 :] if len(heard) else rows
    return rows if (expected[rows] ** 2 / _variance(reading, rows)[:, taxel]).sum() > SURE else rows[:0]


def _heard(expected: FloatArray, reading: Reading, rows: IntArray, taxel: int) -> BoolArray:
    """Whether a taxel answers in some observations, whatever its noise."""
    noise = np.sqrt(_variance(reading, rows)[:, taxel])
    return reading.unlifted[rows, taxel] - _SIGMA * noise >= _SILENT * expected


def _variance(reading: Reading, rows: IntArray) -> FloatArray:
    """What noise alone makes of observations (n, J) [counts²]."""
    return as_floats(reading.sigma_counts**2 / reading.frames[rows][:, None])


def _heard_no_more(
    here: Hypothesis,
    session: GapSession,
    reading: Reading,
    options: RefitOptions,
    taxel: int,
    might: IntArray,
    values: FloatArray,
    costs: FloatArray,
) -> Silent | None:
    """A taxel that is silent in some of the presses in which it might be, and after the first of them for good."""
    deaf = np.ones_like(reading.trust)
    deaf[np.isin(session.press, might), taxel] = 0.0
    own = np.isin(np.arange(len(here.places)), might)
    # The image without the taxel has drawn them elsewhere.
    start = here.with_places(np.where(own[:, None], 0.0, here.places))
    other = reading.trusting(deaf)
    there = _settled(start, session, other, options, might)
    expected = there.values(session)
    silence = {row: _silence(expected[:, taxel], reading, session, row, taxel) for row in might.tolist()}
    # Until it fell silent it told where the press was; in the observation before it may have begun to.
    press_starts = np.append(-1, session.press[:-1]) != session.press
    begin = {row: int(rows[0]) - int(not press_starts[rows[0]]) for row, rows in silence.items() if len(rows)}
    deaf = np.ones_like(reading.trust)
    for row, first in begin.items():
        deaf[(session.press == row) & (np.arange(len(session)) >= first), taxel] = 0.0
    other = reading.trusting(deaf)
    there = _settled(there, session, other, options, might)
    expected = there.values(session)
    left = cost_of_presses(there, other.residual(expected), session, options)
    fall, beyond = costs - left, costs - _usual(costs, session)
    harder = _with_any_force(here, session, reading, options, might)
    shown = [
        row
        for row in begin
        if fall[row] > max(SURE, _TAKEN * beyond[row])
        and harder[row] - left[row] > _RATHER
        and _others_lit(expected, reading, silence[row], taxel)
    ]
    told = np.where(np.isin(session.press, shown), expected[:, taxel], values[:, taxel])
    lit = np.flatnonzero(reading.seen[:, taxel] & (told > _FAINT_COUNTS))
    heard = lit[_heard(told[lit], reading, lit, taxel)]
    # One that never answered did not die, and one that answers later has not.
    shown = [row for row in shown if len(heard) and silence[row][0] > heard[-1]]
    if not shown:
        return None
    first = min(shown, key=lambda row: begin[row])
    row, from_row, time = begin[first], int(silence[first][0]), times(session)
    stuck = float(reading.counts[lit[lit >= from_row], taxel].mean())
    low, high = float(time[max(0, row - 1) : row + 1].mean()), float(time[row : from_row + 1].mean())
    since = low
    if row < from_row:
        part = (reading.counts[row, taxel] - stuck) / max(float(expected[row, taxel]) - stuck, 1e-9)
        # Where the observation is missing, any moment within it will do.
        since += float(np.clip(np.nan_to_num(part, nan=0.5), 0.0, 1.0)) * (high - low)
    whole = float(fall[shown].sum())
    return Silent(
        Dead(taxel, since, stuck, 0.0),
        (low, float(time[from_row])),
        np.array(shown),
        left[shown],
        whole,
        min(1.0, whole / float(beyond[shown].sum())),
    )


def _with_any_force(
    here: Hypothesis, session: GapSession, reading: Reading, options: RefitOptions, rows: IntArray
) -> FloatArray:
    """What presses cost (P,) that may have had any force: one that was lost, or slipped, is no fault of a taxel."""
    loose = replace(options, force_sigma=_ANY_FORCE)
    there = _settled(here, session, reading, loose, rows)
    return cost_of_presses(there, reading.residual(there.values(session)), session, loose)


def _others_lit(expected: FloatArray, reading: Reading, rows: IntArray, taxel: int) -> bool:
    """Whether other taxels show the press while one is silent; an image of nothing has no place."""
    shown = np.minimum(expected[rows], np.where(reading.seen[rows], reading.unlifted[rows], 0.0))
    share = np.maximum(shown, 0.0) ** 2 / _variance(reading, rows)
    return bool(np.delete(share, taxel, axis=1).sum() > SURE)


def presses_of(silent: Sequence[Silent]) -> IntArray:
    """Rows of the presses that show taxels falling silent."""
    return np.array([row for one in silent for row in one.presses.tolist()], dtype=np.int64)


def without_silent(reading: Reading, silent: Sequence[Silent], session: GapSession) -> Reading:
    """The reading with no trust in taxels once they may be silent.

    Args:
        reading: of the session, or of another one at another rate.
        silent: taxels.
        session: gives the times of the reading.
    """
    trust, time = reading.trust.copy(), times(session)
    for one in silent:
        trust[time >= one.between_s[0], one.dead.taxel] = 0.0
    return replace(reading, trust=trust)


def with_silent_values(reading: Reading, silent: Sequence[Silent], session: GapSession) -> Reading:
    """The reading with as much trust in taxels that are surely silent as in others then; arguments as of the above.

    A mean of frames in which a taxel falls silent says nothing, as long as a sample of it is either silent or not.
    """
    trust, time = reading.trust.copy(), times(session)
    for one in silent:
        late, taxel = time >= one.between_s[1], one.dead.taxel
        trust[late, taxel] = reading.trust[late].max(axis=1) * np.isfinite(reading.counts[late, taxel])
    return replace(reading, trust=trust)
