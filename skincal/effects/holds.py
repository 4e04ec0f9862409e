"""Presses without frames as sessions of samples: load, hold, unload; the contact history of their sites.

A dataset without frames has one mean image per press, that of the hold. Effects with memory depend on the course of
the press, so a standard press is simulated: the force rises linearly from t_start to t_hold, stays until t_release and
falls to zero at t_end. A press whose branch is ``down`` rises to a higher force in the first half of the loading and
returns to the hold from above. Unknown times default to half a second for loading and for unloading, one second for
the hold, and one second of rest before the next press.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD, Samples
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats, check_shape


def met_before(site: IntArray, cycle: FloatArray, force_n: FloatArray) -> FloatArray:
    """Return the largest force of earlier touches of the same site (P,) [N], zero at its first one.

    For a site whose earlier touches are not among the presses, it is the median of the other sites' values. It is NaN
    where the number of touches is unknown, and for all repeats if no press has an earlier touch in the data.

    Args:
        site: (P,) site of each press, presses in the order of time.
        cycle: (P,) earlier touches of the site; equal in presses of one touch, such as plateaus of a staircase; NaN if
            unknown.
        force_n: (P,) force of each press [N].
    """
    met = np.where(cycle == 0, 0.0, np.nan)
    for k in np.flatnonzero(cycle > 0):
        before = (site[:k] == site[k]) & (cycle[:k] < cycle[k]) & np.isfinite(force_n[:k])
        met[k] = force_n[:k][before].max() if before.any() else np.nan
    again = cycle > 0
    told = met[again & np.isfinite(met)]
    return np.where(again & np.isnan(met), np.median(told) if len(told) else np.nan, met)


LOADING_S = 0.5
HOLD_S = 1.0
REST_S = 1.0
OVERSHOOT = 1.5
"""Peak force of a press whose hold is reached from above, relative to the hold's force."""


@dataclass(frozen=True)
class Steps:
    """Numbers of samples in the parts of a press.

    Attributes:
        load: samples while the force rises; the last has the hold's force.
        hold: samples in the hold, whose mean is the press's image.
        unload: samples while the force falls; the last has no force.
    """

    load: int = 12
    hold: int = 10
    unload: int = 12

    @property
    def all(self) -> int:
        """Samples of a press, with one at rest after it."""
        return self.load + self.hold + self.unload + 1


@dataclass(frozen=True, eq=False)
class HoldSession:
    """A session of samples made from presses.

    Attributes:
        samples: samples in the order of time.
        row: (K,) row of the press of each sample.
        hold: (H, S) indices of the samples in the hold of each press.
    """

    samples: Samples
    row: IntArray
    hold: IntArray

    def means(self, values: FloatArray) -> FloatArray:
        """Return the mean image in the hold of each press (H, J), from the values of all samples (K, J)."""
        return values[self.hold].mean(axis=1)


def hold_times(
    count: int,
    t_start_s: ArrayLike | None = None,
    t_hold_s: ArrayLike | None = None,
    t_release_s: ArrayLike | None = None,
    t_end_s: ArrayLike | None = None,
) -> FloatArray:
    """Return start, hold, release and end of presses in the order of time (H, 4) [s], with defaults for unknown times.

    A press without any known time follows the one before.

    Args:
        count: number of presses H.
        t_start_s: (H,) [s], NaN where unknown; likewise the others.
        t_hold_s: [s].
        t_release_s: [s].
        t_end_s: [s].
    """
    given = [t_start_s, t_hold_s, t_release_s, t_end_s]
    times = np.column_stack([np.full(count, np.nan) if g is None else as_floats(g) for g in given])
    check_shape("press times", times, (count, 4))
    lasts = np.array([LOADING_S, HOLD_S, LOADING_S])
    after = np.concatenate([[0.0], np.cumsum(lasts)])
    end = -np.inf
    for press in times:
        known = np.isfinite(press)
        anchor = int(np.argmax(known))
        begin = press[anchor] - after[anchor] if known.any() else max(0.0, end + REST_S)
        begin = max(begin, end)
        for k in range(4):
            earliest = begin if k == 0 else press[k - 1]
            guess = begin if k == 0 else press[k - 1] + lasts[k - 1]
            press[k] = max(press[k], earliest) if known[k] else guess
        end = press[3]
    return times


def hold_session(
    holds: Samples, times_s: FloatArray, steps: Steps | None = None, *, down: ArrayLike | None = None
) -> HoldSession:
    """Return a session with the standard presses of given holds.

    Args:
        holds: H samples, one per press, in the order of time.
        times_s: (H, 4) of :func:`hold_times` [s].
        steps: number of samples per part of a press.
        down: (H,) True if the hold is reached from above.
    """
    steps = steps or Steps()
    falls = np.zeros(len(holds), dtype=np.bool_) if down is None else np.asarray(down, dtype=np.bool_)
    row = np.repeat(np.arange(len(holds)), steps.all)
    share, time = _course(times_s, steps, falls)
    phase = np.repeat([LOAD, HOLD, UNLOAD, IDLE], [steps.load, steps.hold, steps.unload, 1])
    start = np.arange(len(holds))[:, None] * steps.all + steps.load
    played = holds[row]
    contacts = replace(played.contacts, force_n=played.contacts.force_n * share.ravel())
    idle = np.tile(phase, len(holds)) == IDLE
    samples = replace(
        played,
        contacts=contacts,
        touching=played.touching & ~idle,
        press=np.where(idle, -1, played.press),
        time_s=time.ravel(),
        phase=np.tile(phase, len(holds)),
        start_s=float("nan"),
    )
    return HoldSession(samples, row, start + np.arange(steps.hold))


def _course(times_s: FloatArray, steps: Steps, down: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the force relative to the hold's, and the times [s], of all samples per press: (H, steps.all) each."""
    start, hold, release, end = (times_s[:, k, None] for k in range(4))
    rise = np.arange(1, steps.load + 1) / steps.load
    stay = np.arange(1, steps.hold + 1) / (steps.hold + 1)
    fall = np.arange(1, steps.unload + 1) / steps.unload
    gap = np.minimum(np.append(start[1:, 0], np.inf) - end[:, 0], REST_S)
    rest = (end[:, 0] + np.maximum(gap, 0.0) / 2)[:, None]
    falling = release + fall * (end - release)
    time = np.hstack([start + rise * (hold - start), hold + stay * (release - hold), falling, rest])
    over = np.where(rise <= 0.5, 2 * OVERSHOOT * rise, OVERSHOOT + (1 - OVERSHOOT) * (2 * rise - 1))
    load = np.where(down[:, None], over, rise)
    flat = np.ones((len(times_s), 1))
    return np.hstack([load, flat * np.ones(steps.hold), flat * (1 - fall), flat * 0.0]), time
