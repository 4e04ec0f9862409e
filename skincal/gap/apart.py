"""How much taxels differ from each other under the same pressure, beyond level and gain: what no common equation tells.

In a chamber all taxels feel the same. Still each has its own way of answering: one lags a little more than the others,
one wanders. Effects are equations for all taxels; what is one taxel's own is, for them, noise. Left out of the noise,
it makes up most of the residual, and what all taxels have in common, though plain to the eye, explains little of that.

The counts y of taxel j in observation i are split into a line of its own over the pressure p, what all have in common,
and the rest:

    y_ij = a_j + b_j (p_i + m_i) + e_ij,    m_i the median over taxels of (y_ij - a_j - b_j p_i) / b_j
"""

from __future__ import annotations

import numpy as np

from skincal.gap.noise import NORMAL
from skincal.gap.reading import Reading
from skincal.inference.session import GapSession
from skincal.gap.signatures import session_mean
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats

_FEWEST_TAXELS, _FEWEST = 8, 10
"""Fewer taxels have no middle one, fewer observations no scatter."""
_ROUNDS = 3
_MOST = 5.0
"""A taxel's own way is no more than so many times what the middle taxel scatters."""
_NEAR_BOUND = 0.5


def own_variance(session: GapSession, reading: Reading, among: BoolArray) -> FloatArray:
    """Variance (J,) of what each taxel does alone under a pressure that all feel [counts²]; zero where not known.

    Args:
        session: under uniform pressure.
        reading: what was read.
        among: (N,) observations that may be looked at.
    """
    samples = session.samples
    force = session_mean(session, np.where(samples.touching, samples.contacts.force_n, 0.0))
    believed = reading.seen & ~_at_bound(np.nan_to_num(reading.counts), reading)
    pressed = among & (session.press >= 0) & np.isfinite(force) & believed.any(axis=1)
    rows: IntArray = np.flatnonzero(pressed)
    counts, seen = np.nan_to_num(reading.unlifted[rows]), believed[rows]
    known = seen.sum(axis=0) >= _FEWEST
    variance = np.zeros(counts.shape[1])
    if known.sum() < _FEWEST_TAXELS:
        return variance
    rest = _rest(force[rows] / force[rows].max(), counts[:, known], seen[:, known])
    noise = reading.deviation(np.nan_to_num(reading.unlifted))[rows][:, known]
    scatter = [NORMAL * np.median(np.abs(rest[own, j])) for j, own in enumerate(seen[:, known].T)]
    by_noise = [np.median(noise[own, j] ** 2) for j, own in enumerate(seen[:, known].T)]
    # What is far out is no way of answering.
    most = _MOST * np.median(scatter)
    variance[known] = np.clip(np.array(scatter) ** 2 - np.array(by_noise), 0.0, most**2)
    return variance


def _at_bound(counts: FloatArray, reading: Reading) -> BoolArray:
    """Where a taxel (n, J) sits at a bound of the converter: stuck, which is to be found, not to be allowed for."""
    at = np.zeros(counts.shape, dtype=np.bool_)
    for bound in (reading.readout.value_min, reading.readout.value_max):
        if bound is not None:
            at |= np.abs(counts - bound) < _NEAR_BOUND
    return at


def _rest(pressure: FloatArray, counts: FloatArray, seen: BoolArray) -> FloatArray:
    """What neither an own line nor what all taxels have in common explains (n, J), zero where nothing was read."""
    common = np.zeros(len(pressure))
    rest = np.zeros_like(counts)
    for _ in range(_ROUNDS):
        slopes, rest = np.zeros(counts.shape[1]), np.zeros_like(counts)
        for j, own in enumerate(seen.T):
            line: FloatArray = np.stack([np.ones(int(own.sum())), (pressure + common)[own]], axis=1)
            found = as_floats(np.linalg.lstsq(line, as_floats(counts[own, j]), rcond=None)[0])
            slopes[j], rest[own, j] = found[1], counts[own, j] - line @ found
        lively = slopes > 0.2 * np.median(slopes)
        relative = np.where(seen & lively, rest / np.where(lively, slopes, 1.0), np.nan)
        some = np.isfinite(relative).any(axis=1)
        common[some] += np.nanmedian(relative[some], axis=1)
    return as_floats(rest)
