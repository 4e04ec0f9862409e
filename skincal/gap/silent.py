"""Taxels that fall silent late, so that one press shows it, or a few, and taxels that never answer.

A press over a taxel that has just died fits nowhere; where it is the only one, or one of few, it looks like a glitch.
It is none if its image is right once that one taxel is not looked at, but no other force makes it so, and if the taxel
answered before and no later press shows it answering.

A press that may lie elsewhere within its slack hides such a taxel: it moves to where the taxel need not answer, and the
sensor moves with many of them. So all presses after the last answer of a taxel, or all where it never answers, are also
looked at together, from where they were measured: a taxel that is silent leaves them no worse there, and each of them a
little better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.gap.hypothesis import Hypothesis
from skincal.gap.problem import RefitOptions, cost_of_presses
from skincal.gap.reading import Reading
from skincal.gap.relocate import of_presses, relocated
from skincal.gap.robust import SURE, Dead, times
from skincal.inference.session import GapSession
from skincal.gap.settle import settled
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats

_SILENT = 0.2
"""A taxel that reads less than this part of what it should is silent."""
_FAINT_COUNTS = 4.0
"""Silence begins where a taxel should read so much, once it is sure that there is any."""
_PICKED_UP = 0.1
"""A silent taxel picks up at most this part of what it should read, from its neighbours' lines."""
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
_TOGETHER = 40.0
"""Presses show together that a taxel is silent if its silence leaves so much less of them: odds of exp(20) to one, as
far as noise and places go."""
_SEVERAL = 2
"""So many presses show something together at least."""
_CLEAR_COUNTS = 15.0
"""What a taxel reads is an answer, whatever the model, if it is more than that."""
_SHOULD_COUNTS = 10.0
"""One of the presses that show together that a taxel is silent should light it so much."""
_IN_THE_DARK = 3
"""So many presses at least that show nothing at all have not missed the sensor, and so many times those that have."""
_MIDDLE = 2 * np.log(2.0)
"""The median of the squared distance of places that scatter by one in both directions."""
MOST_SILENT = 3
"""No more taxels than one in so many fall silent; where they do, it is something else."""


@dataclass(frozen=True, eq=False)
class Silent:
    """A taxel that was seen to fall silent.

    Attributes:
        dead: the taxel, since when, and what it reads.
        between_s: it was heard before the first time, and silent from the second one on [s]; both are when the
            session begins where it was never heard.
        presses: rows of the P presses that show it.
        left: (P,) what each of them costs without the taxel's silence.
        falls: (P,) by how much that is less than with it.
        fall: all of that together.
        share: the part of what they cost beyond the usual that this is.
    """

    dead: Dead
    between_s: tuple[float, float]
    presses: IntArray
    left: FloatArray
    falls: FloatArray
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
    """Taxels that fall silent in one press or a few, and are not heard of again, or that never are.

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
        ways: list[Silent | None] = []
        if 0 < len(might) <= _FEW:
            ways += [_heard_no_more(here, session, reading, options, taxel, np.array(might), values, costs)]
        later = _after_the_last_answer(measured[:, taxel], reading, session, taxel)
        if len(later):
            ways += [_silent_together(here, session, reading, options, taxel, later, values, costs, measured)]
        seen = [one for one in ways if one is not None]
        found_silent += [max(seen, key=lambda one: (len(one.presses), one.fall))] if seen else []
    best = _best_of_each_press(found_silent)
    return best if len(best) <= values.shape[1] // MOST_SILENT else []


def _best_of_each_press(silent: Sequence[Silent]) -> list[Silent]:
    """Those that explain a press better than any other does, which may explain it as well from another place."""
    return [one for one in silent if not any(_beaten(one, other) for other in silent)]


def _beaten(one: Silent, other: Silent) -> bool:
    """Whether another taxel's silence explains the presses better that both of them explain."""
    _, mine, its = np.intersect1d(one.presses, other.presses, return_indices=True)
    return float(one.left[mine].sum()) > float(other.left[its].sum())


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


def _no_more_than_faint(reading: Reading, rows: IntArray, taxel: int) -> bool:
    """Whether a taxel reads so little in observations that its neighbours' lines may have brought it."""
    noise = np.sqrt(_variance(reading, rows)[:, taxel])
    return bool((reading.unlifted[rows, taxel] - _SIGMA * noise <= _FAINT_COUNTS).all())


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
    silence = {row: silence[row] for row in shown}
    return _seen(session, reading, taxel, shown, values, expected, silence, costs, left)


def _seen(
    session: GapSession,
    reading: Reading,
    taxel: int,
    shown: list[int],
    values: FloatArray,
    expected: FloatArray,
    silence: Mapping[int, IntArray],
    costs: FloatArray,
    left: FloatArray,
) -> Silent | None:
    """A taxel that some presses show to be silent, if it is not heard again, and was before or several show it.

    Args:
        session: what was pressed.
        reading: of all presses.
        taxel: its column.
        shown: rows of the presses.
        values: (N, J) of the model.
        expected: the same where these presses are without the taxel.
        silence: the observations in which it is silent, of these presses and of others that it was silent in then.
        costs: (P,) what presses cost.
        left: (P,) the same without the taxel.
    """
    told = np.where(np.isin(session.press, shown), expected[:, taxel], values[:, taxel])
    lit = np.flatnonzero(reading.seen[:, taxel] & (told > _FAINT_COUNTS))
    heard = lit[_heard(told[lit], reading, lit, taxel)]
    if _no_more_than_faint(reading, heard, taxel):
        heard = heard[:0]
    last = int(heard[-1]) if len(heard) else -1
    # One that answers later has not died; that one never answered must be told by several presses.
    shown = [row for row in shown if silence[row][0] > last]
    if len(shown) < (1 if len(heard) else _SEVERAL):
        return None
    from_row = min(int(rows[0]) for rows in silence.values() if rows[0] > last)
    stuck = float(reading.counts[lit[lit >= from_row], taxel].mean())
    if len(heard):
        since, between = _falls_silent(session, reading.counts[:, taxel], expected[:, taxel], from_row, stuck)
    else:
        begin = float(times(session)[0])
        since, between = 0.0, (begin, begin)
    falls, beyond = (costs - left)[shown], costs[shown] - _usual(costs, session)
    whole = float(falls.sum())
    return Silent(
        Dead(taxel, since, stuck, 0.0),
        between,
        np.array(shown),
        left[shown],
        falls,
        whole,
        min(1.0, whole / max(float(beyond.sum()), 1.0)),
    )


def _falls_silent(
    session: GapSession, counts: FloatArray, expected: FloatArray, from_row: int, stuck: float
) -> tuple[float, tuple[float, float]]:
    """When a taxel falls silent that is silent from some observation on, and between which times at most [s].

    Args:
        session: gives the times.
        counts: (N,) that it reads.
        expected: (N,) that it should.
        from_row: the observation.
        stuck: what it reads then.
    """
    first = from_row - int(session.press[from_row - 1] == session.press[from_row])
    time = times(session)
    low, high = float(time[max(0, first - 1) : first + 1].mean()), float(time[first : from_row + 1].mean())
    since = low
    if first < from_row:
        part = (counts[first] - stuck) / max(float(expected[first]) - stuck, 1e-9)
        # Where the observation is missing, any moment within it will do.
        since += float(np.clip(np.nan_to_num(part, nan=0.5), 0.0, 1.0)) * (high - low)
    return since, (low, float(time[from_row]))


def _after_the_last_answer(
    measured: FloatArray, reading: Reading, session: GapSession, taxel: int
) -> IntArray:
    """Rows of presses after the last clear answer of a taxel in which it should answer, at their measured places.

    All such presses where it never answered.
    """
    rows = np.flatnonzero(reading.seen[:, taxel])
    noise = _SIGMA * np.sqrt(_variance(reading, rows)[:, taxel])
    answers = rows[reading.unlifted[rows, taxel] - noise > _CLEAR_COUNTS]
    later = np.unique(session.press[answers[-1] + 1 :] if len(answers) else session.press)
    later = later[later >= 0]
    later = later[later != session.press[answers[-1]]] if len(answers) else later
    return np.array(
        [p for p in later.tolist() if len(_silence(measured, reading, session, p, taxel))], dtype=np.int64
    )


def _silent_together(
    here: Hypothesis,
    session: GapSession,
    reading: Reading,
    options: RefitOptions,
    taxel: int,
    later: IntArray,
    values: FloatArray,
    costs: FloatArray,
    measured: FloatArray,
) -> Silent | None:
    """A taxel whose silence explains presses after its last answer better than their places and forces do."""
    own = np.isin(np.arange(len(here.places)), later)
    deaf = np.ones_like(reading.trust)
    deaf[np.isin(session.press, later), taxel] = 0.0
    other = reading.trusting(deaf)
    # From a measured place the way may be lost where nothing else answers: from where it is it is not, and on a grid
    # there is none to lose.
    placed = here.with_places(np.where(own[:, None], 0.0, here.places))
    starts = placed, relocated(placed, *of_presses(session, other, later), options), here
    ways = [_settled(start, session, other, options, later) for start in starts]
    images = [way.values(session) for way in ways]
    # What a silent taxel reads costs something, too.
    all_left = np.stack(
        [
            cost_of_presses(way, other.residual(image), session, options)
            + _of_what_it_picks_up(image, session, reading, later, taxel)
            for way, image in zip(ways, images, strict=True)
        ]
    )
    left, best = all_left.min(axis=0), all_left.argmin(axis=0)
    expected = np.stack(images)[best[np.maximum(session.press, 0)], np.arange(len(session))]
    silence = {row: _silence(expected[:, taxel], reading, session, row, taxel) for row in later.tolist()}
    better = [row for row, rows in silence.items() if len(rows) and left[row] < costs[row]]
    shown = [row for row in better if _others_lit(expected, reading, silence[row], taxel)]
    dark = [row for row in better if row not in shown]
    bright = [row for row in dark if float(expected[silence[row], taxel].max()) > _CLEAR_COUNTS]
    if len(shown) < _SEVERAL and len(bright) < _IN_THE_DARK:
        return None
    falls = np.minimum(costs, _with_any_force(here, session, reading, options, later)) - left
    if _none_missed(bright, falls, here, session, reading, options, measured):
        shown, dark = sorted([*shown, *bright]), [row for row in dark if row not in bright]
    clear = any(float(expected[silence[row], taxel].max()) > _SHOULD_COUNTS for row in shown)
    # One alone may be wrong for another reason, and is judged as such.
    if len(shown) < _SEVERAL or not clear:
        return None
    told, untold = falls[shown].sum(), falls[dark].sum()
    # Presses that show nothing at all may have missed: what they say counts by as much as what the others do at most.
    if told + min(told, untold) < _TOGETHER:
        return None
    # Once it is sure, it was silent in the others, too.
    silence = {
        row: rows if len(rows) else _silence(measured[:, taxel], reading, session, row, taxel)
        for row, rows in silence.items()
    }
    return _seen(session, reading, taxel, shown, values, expected, silence, costs, left)


def _none_missed(
    dark: list[int],
    falls: FloatArray,
    here: Hypothesis,
    session: GapSession,
    reading: Reading,
    options: RefitOptions,
    measured: FloatArray,
) -> bool:
    """Whether presses over a taxel that show nothing at all have not just missed the sensor.

    They are several, no press over a taxel that answers later has missed in that way, or far fewer, and they would have
    to lie further off than places in this session are.

    Args:
        dark: rows of these presses.
        falls: (P,) by how much less presses cost with the taxel silent.
        here: the fit.
        session: what was pressed.
        reading: of all presses.
        options: priors of places.
        measured: (N, J) values of presses where they were measured.
    """
    if len(dark) < _IN_THE_DARK:
        return False
    touching = np.unique(session.press[session.press >= 0])
    lit = np.where(
        reading.seen, reading.unlifted - _SIGMA * np.sqrt(_variance(reading, np.arange(len(session)))), 0.0
    )
    last = [int(rows[-1]) if len(rows := np.flatnonzero(one > _CLEAR_COUNTS)) else -1 for one in lit.T]
    missed = 0
    for row in np.setdiff1d(touching, dark).tolist():
        own = np.flatnonzero(session.press == row)
        brightest = int(measured[own].max(axis=0).argmax())
        should = own[(measured[own, brightest] > _CLEAR_COUNTS) & reading.seen[own, brightest]]
        answers = last[brightest] > own[-1]
        missed += len(should) > 0 and answers and not (lit[own] > _FAINT_COUNTS).any()
    others = np.setdiff1d(touching, dark)
    moves = (here.places[others, :2] ** 2).sum(axis=1) / options.position_sigma_m**2
    scatter = max(1.0, float(np.median(moves)) / _MIDDLE) if len(others) else 1.0
    return bool(_IN_THE_DARK * missed <= len(dark) and falls[dark].sum() / scatter > _TOGETHER)


def _of_what_it_picks_up(
    expected: FloatArray, session: GapSession, reading: Reading, rows: IntArray, taxel: int
) -> FloatArray:
    """What it costs presses (P,) that a silent taxel reads what it does: some part of what it should, from others."""
    mine = np.isin(session.press, rows)
    should, weight = expected[mine, taxel], reading.frames[mine]
    read = np.where(reading.seen[mine, taxel], reading.unlifted[mine, taxel], 0.0)
    part = (weight * read * should).sum() / max(float((weight * should**2).sum()), 1e-9)
    silent = np.zeros_like(expected)
    silent[:, taxel] = np.clip(part, 0.0, _PICKED_UP) * expected[:, taxel]
    costs = reading.residual(silent)[mine, taxel] ** 2
    return as_floats(np.bincount(session.press[mine], costs, session.presses))


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
