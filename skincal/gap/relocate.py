"""A second look at where presses were: a fit that goes downhill may leave one in the wrong valley.

A press at the edge of a taxel, or off the sensor's border, can have more than one place at which its image is nearly
right, and while the sensor is not yet where it belongs the wrong one may be the nearer. Once the sensor is found, every
press is looked for again on a grid (:mod:`skincal.gap.start`); where there are other places, the three best are
followed downhill with the sensor held, as is the present one, and the best of all is kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.gap.hypothesis import Hypothesis
from skincal.gap.problem import RefitOptions, cost_of_presses
from skincal.gap.reading import Reading
from skincal.inference.session import GapSession
from skincal.gap.settle import settled
from skincal.gap.start import STEPS, valleys
from skincal.model.arrays import BoolArray, FloatArray, IntArray

_REACH = 4.0
"""How far to look, in standard deviations of a measured place."""
_HOPELESS = (5.0, 1.5)
"""Another place is given up that costs more than so many times what the present one does, and ``_AS_RIGHT``: after the
first step downhill, and after the second."""
_FURTHER = 2
"""More steps where it is still open which place is the better one."""
_VALLEYS = 3
"""So many places of a press are followed at most."""
_AS_RIGHT = 16.0
"""Another place is as right if it costs at most so much more: four standard deviations, to allow for an inexact contact
law."""
_ELSEWHERE = 0.5
"""So far off is another place [standard deviations of a measured one]."""
_TO_THE_BOTTOM = 6
"""Steps of every press to its best place."""
_SHARES = 2
"""Presses are followed in so many shares."""
_SAME = 1.5
"""Places nearer than so many steps of the grid are the same."""
_MET = 0.1
"""So near to each other [standard deviations of a measured one] two places end in the same valley."""


def relocated(
    found: Hypothesis, session: GapSession, reading: Reading, options: RefitOptions, reach_m: float = np.inf
) -> Hypothesis:
    """The hypothesis with those presses moved that fit better at another place; itself where none does.

    Args:
        found: by a fit.
        session: what was pressed.
        reading: what was read.
        options: priors of the fit.
        reach_m: how far from its measured place a press is looked for at most [m].
    """
    ends, costs = _ends(found, session, reading, options, reach_m)
    best = np.argmin(costs, axis=1)
    if not best.any():
        return found
    moved = np.take_along_axis(ends, best[:, None, None], axis=1)[:, 0]
    return found.with_places(np.where((best > 0)[:, None], moved, found.places))


def at_best(found: Hypothesis, session: GapSession, reading: Reading, options: RefitOptions) -> Hypothesis:
    """The hypothesis with every press where it fits best, sensor and effects as they are; arguments as above."""
    placed = relocated(found, session, reading, options)
    return settled(placed, session, reading, options, _TO_THE_BOTTOM)[0]


def ambiguous(
    found: Hypothesis, session: GapSession, reading: Reading, options: RefitOptions, reach_m: float = np.inf
) -> BoolArray:
    """Presses (P,) whose images are as right at another place; arguments as of :func:`relocated`."""
    ends, costs = _ends(found, session, reading, options, reach_m)
    apart = np.hypot(*np.moveaxis(ends[:, 1:, :2] - ends[:, :1, :2], -1, 0))
    near = costs[:, 1:] < costs[:, :1] + _AS_RIGHT
    return (near & (apart > _ELSEWHERE * options.position_sigma_m)).any(axis=1)


def _ends(
    found: Hypothesis, session: GapSession, reading: Reading, options: RefitOptions, reach_m: float
) -> tuple[FloatArray, FloatArray]:
    """Where presses end (P, 1 + n, 3) that go downhill from where they are and from other valleys, and their costs.

    The first is the present place. A press with no other valley stays there, and is said to cost nothing; a valley that
    there is not costs infinitely much.
    """
    ends = np.repeat(found.places[:, None], 1 + _VALLEYS, axis=1)
    costs = np.full(ends.shape[:2], np.inf)
    costs[:, 0] = 0.0
    if not options.base:
        # Under uniform pressure, where the sensor is not free, every place looks the same.
        return ends, costs
    parts = [found.model, found.effects, found.places, session, reading, options, reach_m]
    kept = options.keep(
        "ends", parts, lambda: _followed(found, session, reading, options, reach_m, ends, costs)
    )
    return kept["ends"], kept["costs"]


def _followed(
    found: Hypothesis,
    session: GapSession,
    reading: Reading,
    options: RefitOptions,
    reach_m: float,
    ends: FloatArray,
    costs: FloatArray,
) -> dict[str, FloatArray]:
    """The ends and costs of :func:`_ends`, entered where they are to be."""
    presses = np.unique(session.press[session.press >= 0])
    # Always the same shares, so that what is found does not depend on who works them out.
    shares = [rows for rows in np.array_split(presses, _SHARES) if len(rows)]
    tasks = [
        (
            found,
            *of_presses(session, reading, rows),
            options.alone,
            min(_REACH * options.position_sigma_m, reach_m),
        )
        for rows in shares
    ]
    for rows, (end, cost) in zip(shares, options.mapper(_ends_of, tasks), strict=True):
        ends[rows], costs[rows] = end[rows], cost[rows]
    return {"ends": ends, "costs": costs}


def _ends_of(
    task: tuple[Hypothesis, GapSession, Reading, RefitOptions, float],
) -> tuple[FloatArray, FloatArray]:
    """See :func:`_ends`, of some presses."""
    found, session, reading, options, reach = task
    others = np.full((len(found.places), _VALLEYS, 2), np.nan)
    near = valleys(found.skin, session, reading, options.position_sigma_m, reach, _VALLEYS)
    others[: len(near)] = near
    apart = np.hypot(*np.moveaxis(others - found.places[:, None, :2], -1, 0))
    wanted = apart > _SAME * 2 * reach / (STEPS - 1)
    ends = np.repeat(found.places[:, None], 1 + _VALLEYS, axis=1)
    costs = np.full(ends.shape[:2], np.inf)
    costs[:, 0] = 0.0
    ends[:, 1:, :2] = np.where(wanted[..., None], others, ends[:, 1:, :2])
    ends[:, 1:, 2] = 0.0

    def follow(k: int, rows: IntArray, steps: int) -> None:
        if len(rows):
            part, read = of_presses(session, reading, rows)
            end, left = settled(found.with_places(ends[:, k]), part, read, options, steps)
            ends[rows, k] = end.places[rows]
            costs[rows, k] = cost_of_presses(end, left, part, options)[rows]

    follow(0, np.flatnonzero(wanted.any(axis=1)), len(_HOPELESS))
    for hopeless in _HOPELESS:
        for k in range(1, 1 + _VALLEYS):
            follow(k, np.flatnonzero(wanted[:, k - 1]), 1)
        wanted &= costs[:, 1:] < hopeless * (costs[:, :1] + _AS_RIGHT)
    apart = np.hypot(*np.moveaxis(ends[:, 1:, :2] - ends[:, :1, :2], -1, 0))
    met = wanted & (apart <= _MET * options.position_sigma_m)
    # Neither the same place once more nor one beyond the rim of a mesh is another place.
    costs[:, 1:][met | np.isnan(costs[:, 1:])] = np.inf
    wanted &= ~met
    follow(0, np.flatnonzero(wanted.any(axis=1)), _FURTHER)
    for k in range(1, 1 + _VALLEYS):
        follow(k, np.flatnonzero(wanted[:, k - 1]), _FURTHER)
    return ends, costs


def of_presses(session: GapSession, reading: Reading, rows: IntArray) -> tuple[GapSession, Reading]:
    """A session and its reading of some presses only; rows of presses stay as they are numbered."""
    keep = np.isin(session.press, rows)
    number = np.cumsum(keep) - 1
    seen = session.observation >= 0
    kept = seen & keep[np.maximum(session.observation, 0)]
    samples = np.isin(session.row, rows) & (kept | ~seen)
    some = replace(
        session,
        samples=session.samples[np.flatnonzero(samples)],
        row=session.row[samples],
        observation=np.where(kept, number[np.maximum(session.observation, 0)], -1)[samples],
        press=session.press[keep],
        phase=session.phase[keep],
        frames=session.frames[keep],
        counts=None if session.counts is None else session.counts[keep],
    )
    read = replace(
        reading,
        counts=reading.counts[keep],
        frames=reading.frames[keep],
        trust=reading.trust[keep],
        further=reading.further[keep],
        lift=reading.lift[keep],
    )
    return some, read
