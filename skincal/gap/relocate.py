"""A second look at where presses were: a fit that goes downhill may leave one in the wrong valley.

A press at the edge of a taxel, or off the sensor's border, can have more than one place at which its image is nearly
right, and while the sensor is not yet where it belongs the wrong one may be the nearer. Once the sensor is found, every
press is looked for again on a grid (:mod:`skincal.gap.start`); where that is another place, both are followed downhill
with the sensor held, and the better one is kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.gap.hypothesis import Hypothesis
from skincal.gap.reading import Reading
from skincal.gap.refit import RefitOptions, refit
from skincal.gap.session import GapSession
from skincal.gap.start import STEPS, start_places
from skincal.model.arrays import FloatArray, IntArray

_REACH = 4.0
"""How far to look, in standard deviations of a measured place."""
_STEPS = 4
_SAME = 1.5
"""Places nearer than so many steps of the grid are the same."""


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
    sigma = options.position_sigma_m
    reach = min(_REACH * sigma, reach_m)
    others = start_places(found.model, session, reading, sigma, reach)
    apart = np.hypot(*(others - found.places)[:, :2].T)
    rows = np.flatnonzero(apart > _SAME * 2 * reach / (STEPS - 1))
    if not len(rows):
        return found
    part, read = of_presses(session, reading, rows)
    settled = replace(options, base=False, settle=_STEPS, steps=_STEPS)
    there = refit(found.with_places(others), part, read, settled, fixed=found.effects)
    here = refit(found, part, read, settled, fixed=found.effects)
    costs = [cost_of_presses(r.hypothesis, r.slopes.residual, part, options) for r in (here, there)]
    better = rows[(costs[1] < costs[0])[rows]]
    if not len(better):
        return found
    places = found.places.copy()
    places[better] = there.hypothesis.places[better]
    return found.with_places(places)


def cost_of_presses(
    hypothesis: Hypothesis, residual: FloatArray, session: GapSession, options: RefitOptions
) -> FloatArray:
    """Squared residual and squared move (P,) of each press.

    Args:
        hypothesis: places of presses.
        residual: (N, J) whitened.
        session: says which press each observation is of.
        options: priors of places.
    """
    own = session.press >= 0
    squares = np.bincount(session.press[own], (residual[own] ** 2).sum(axis=1), len(hypothesis.places))
    return squares + ((hypothesis.places / options.place_prior) ** 2).sum(axis=1)


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
    )
    return some, read
