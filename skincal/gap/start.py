"""Where each press really was, to begin with: the best place of a grid within its slack, sensor as given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import minimum_filter

from skincal.effects import EffectSkin, Samples
from skincal.effects.base import MemoryEffect
from skincal.effects.samples import HOLD
from skincal.gap.hypothesis import PLACE
from skincal.gap.reading import Reading
from skincal.inference.session import GapSession
from skincal.model.arrays import FloatArray, IntArray

STEPS = 15
"""Places of the grid along each direction."""
_IMAGE_ERROR = 0.03
"""What an image may be off anyway, in parts of its values: the place is looked for, not the last digit."""
_FAR_WORSE = 10.0
"""A valley that costs more than so many times the lowest one is not followed."""
_LITTLE = 50.0
"""What a place of the grid costs merely for lying off the bottom."""


def start_places(
    skin: EffectSkin, session: GapSession, reading: Reading, sigma_m: float, reach_m: float
) -> FloatArray:
    """Places (P, 3) of all presses.

    Args:
        skin: the sensor, with the effects that it is known to have.
        session: what was pressed.
        reading: what was read.
        sigma_m: of a measured place [m].
        reach_m: how far to look on each side [m].
    """
    places = np.zeros((session.presses, PLACE))
    places[:, :2] = np.nan_to_num(valleys(skin, session, reading, sigma_m, reach_m, 1)[:, 0])
    return places


def valleys(
    skin: EffectSkin, session: GapSession, reading: Reading, sigma_m: float, reach_m: float, most: int
) -> FloatArray:
    """Places (P, most, 2) at which the image of a press is more nearly right than at any around, best first; NaN: none.

    Those on the border of the grid, whose image may be righter beyond it, count as well.

    Args:
        skin: the sensor. What its effects remember is not looked at: presses are tried one sample at a time.
        session: what was pressed.
        reading: what was read.
        sigma_m: of a measured place [m].
        reach_m: how far to look on each side [m].
        most: places of a press at most.
    """
    found = np.full((session.presses, most, 2), np.nan)
    seen = _observations(session)
    if not len(seen):
        return found
    if skin.has_memory:
        skin = replace(skin, effects=tuple(a for a in skin.effects if not isinstance(a.effect, MemoryEffect)))
    samples = _one_sample(session, seen)
    axis = np.linspace(-reach_m, reach_m, STEPS)
    across, along = (grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij"))
    spots = len(across)
    tried = samples[np.repeat(np.arange(len(seen)), spots)]
    moved = skin.setting.moved(tried, np.tile(across, len(seen)), np.tile(along, len(seen)))
    values = skin.values(moved)[:, session.taxels] if session.taxels is not None else skin.values(moved)
    for i, row in enumerate(seen.tolist()):
        expected = reading.expected_in(row, values[i * spots : (i + 1) * spots])
        spread = np.hypot(reading.sigma_counts / np.sqrt(reading.frames[row]), _IMAGE_ERROR * expected)
        gone = np.where(reading.seen[row], reading.counts[row] - expected, 0.0) / spread
        cost = (gone**2).sum(axis=1) + (across**2 + along**2) / sigma_m**2
        # Places beyond the rim of a mesh have no image.
        cost = np.where(np.isfinite(cost), cost, np.inf)
        around = minimum_filter(cost.reshape(STEPS, STEPS), size=3, mode="nearest").ravel()
        lowest = np.flatnonzero((cost <= around) & np.isfinite(cost))
        lowest = lowest[np.argsort(cost[lowest], kind="stable")][:most]
        lowest = lowest[cost[lowest] <= _FAR_WORSE * (cost.min() + _LITTLE)]
        found[session.press[row], : len(lowest)] = np.stack([across[lowest], along[lowest]], axis=-1)
    return found


def _observations(session: GapSession) -> IntArray:
    """For each press the observation in the middle of its hold, or its strongest one; in the order of time."""
    found: list[int] = []
    strength = (
        np.nan_to_num(session.counts).sum(axis=1) if session.counts is not None else np.zeros(len(session))
    )
    for press in np.unique(session.press[session.press >= 0]).tolist():
        own = np.flatnonzero(session.press == press)
        held = own[session.phase[own] == HOLD]
        found.append(int(held[len(held) // 2]) if len(held) else int(own[np.argmax(strength[own])]))
    # The table of presses may have another order.
    return np.sort(np.array(found, dtype=np.int64))


def _one_sample(session: GapSession, observations: IntArray) -> Samples:
    """A sample of each observation: the middle one of those it is the mean of."""
    order = np.argsort(session.observation, kind="stable")
    at = session.observation[order]
    first = np.searchsorted(at, observations, side="left")
    last = np.searchsorted(at, observations, side="right")
    return session.samples[order[(first + last - 1) // 2]]
