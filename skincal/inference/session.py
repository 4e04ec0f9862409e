"""A session as the diagnosis uses it: samples to simulate, and observed means over some of them.

With frames, consecutive frames of one press and phase are averaged to a few bins, which are samples and observations at
once. At most ``Binning`` bins are made of each press and phase: equal ones of loading and unloading; of the hold and
the rest after a press bins that grow by half each, because relaxation decays. A phase with fewer frames than bins keeps
all of them, so quick ramps are not averaged.

Without frames the samples are those of a standard press (:func:`skincal.effects.hold_session`), and a press has one
observation, the mean of its hold. What happened between presses is then unknown, and memory does not reach from one
press to the next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from skincal.covariates import COVARIATES
from skincal.effects import HoldSession, Samples
from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.model import Contacts, Surface
from skincal.model.arrays import FloatArray, IntArray

_GROWTH = 1.5
"""Ratio of the lengths of consecutive bins of a hold or a rest."""

_APART_S = 1e6
"""Time between presses that are not to remember each other [s]."""


@dataclass(frozen=True)
class Binning:
    """Largest number of bins of each phase of a press."""

    load: int = 14
    hold: int = 5
    unload: int = 14
    rest: int = 3

    def of_phase(self, phase: int) -> int:
        """Return the bound of a phase; an unknown one counts as a hold."""
        return {LOAD: self.load, UNLOAD: self.unload, IDLE: self.rest}.get(phase, self.hold)


@dataclass(frozen=True, eq=False)
class GapSession:
    """K samples in the order of time, and N observations that are means over some of them.

    Attributes:
        samples: what is simulated, with the covariates that were recorded.
        row: (K,) row of the press that each sample belongs to, -1 at rest.
        observation: (K,) what it is part of, -1 for nothing.
        press: (N,) row of the press of each observation, -1 at rest.
        phase: (N,) as in :class:`skincal.effects.Samples`.
        frames: (N,) frames that each observation is the mean of.
        counts: (N, J) measured means [counts], NaN where not read; None for a plan.
        has_frames: whether loading and unloading were observed.
    """

    samples: Samples
    row: IntArray
    observation: IntArray
    press: IntArray
    phase: IntArray
    frames: FloatArray
    counts: FloatArray | None = None
    has_frames: bool = True

    def __len__(self) -> int:
        return len(self.press)

    @property
    def presses(self) -> int:
        """Number of presses."""
        return int(self.row.max(initial=-1)) + 1

    @property
    def remembered(self) -> Samples:
        """Samples for effects with memory: without frames presses are moved so far apart that nothing is remembered."""
        if self.has_frames or self.samples.time_s is None:
            return self.samples
        number = np.cumsum(np.diff(self.row, prepend=self.row[:1]) != 0)
        # The pause comes before the moment of rest that ends a press; after it, loading would seem as long.
        number = np.append(number[1:], number[-1:])
        apart = _APART_S * number
        return replace(self.samples, time_s=self.samples.time_s + apart, apart_s=apart)

    def held(self) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Return the mask (N,) of observations in the hold of a press."""
        return (self.phase == HOLD) & (self.press >= 0)

    def mean_force(self) -> FloatArray:
        """Return the mean force (N,) of the samples of each observation [N]."""
        own = np.flatnonzero(self.observation >= 0)
        force = np.nan_to_num(self.samples.contacts.force_n[own]) * self.samples.touching[own]
        at = self.observation[own]
        return np.bincount(at, force, len(self)) / np.maximum(np.bincount(at, minlength=len(self)), 1)

    def of_holds_alone(self) -> GapSession:
        """Return the holds of a session of frames, without memory: enough to fit the pose."""
        own = np.flatnonzero((self.phase == HOLD) & (self.press >= 0))
        if not self.has_frames or not len(own):
            return self
        counts = None if self.counts is None else self.counts[own]
        rows = np.arange(len(own))
        return replace(
            self, samples=self.samples[own], row=self.row[own], observation=rows, press=self.press[own],
            phase=self.phase[own], frames=self.frames[own], counts=counts,
        )  # fmt: skip


def binned(
    frames: Samples,
    row: IntArray,
    counts: FloatArray | None,
    surface: Surface,
    binning: Binning | None = None,
) -> GapSession:
    """Average the frames of a session to bins.

    Args:
        frames: M samples, one for each frame, with phases.
        row: (M,) row of the press of each frame, -1 at rest.
        counts: (M, J) images; None for a plan.
        surface: that mean places are projected to.
        binning: largest numbers of bins.
    """
    assert frames.phase is not None
    bins = bins_of(row, frames.phase, binning or Binning())
    count = int(bins.max(initial=-1)) + 1
    many = np.bincount(bins, minlength=count).astype(np.float64)
    first = np.searchsorted(bins, np.arange(count))

    def mean(column: FloatArray) -> FloatArray:
        flat = column.reshape(len(bins), -1)
        total = np.stack([np.bincount(bins, flat[:, i], count) for i in range(flat.shape[1])], axis=1)
        return (total / many[:, None]).reshape(count, *column.shape[1:])

    part = frames[first]
    averaged = {
        name: None if (column := getattr(frames, name)) is None else mean(column)
        for name in (one.attribute for one in COVARIATES.values() if not one.whole)
    }
    contacts = _mean_contacts(frames, part, mean, surface)
    samples = replace(part, contacts=contacts, start_s=frames.start_s, **averaged)
    assert samples.phase is not None
    own = np.arange(count)
    images = None if counts is None else mean(counts)
    return GapSession(samples, row[first], own, row[first], samples.phase, many, images)


def _mean_contacts(
    frames: Samples, part: Samples, mean: Callable[[FloatArray], FloatArray], surface: Surface
) -> Contacts:
    points, normals = mean(frames.contacts.points_m), mean(frames.contacts.normals)
    known = np.isfinite(points).all(axis=1)
    points[known] = surface.project(points[known])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(np.isfinite(lengths), normals / np.where(lengths > 0, lengths, 1.0), np.nan)
    return Contacts(points, normals, np.where(part.touching, mean(frames.contacts.force_n), 0.0))


def bins_of(row: IntArray, phase: IntArray, binning: Binning) -> IntArray:
    """Return the ascending number (M,) of the bin of each frame."""
    if not len(row):
        return np.zeros(0, dtype=np.int64)
    change = (np.diff(row) != 0) | (np.diff(phase) != 0)
    edges = np.concatenate([[0], np.flatnonzero(change) + 1, [len(row)]])
    bins, last = np.empty(len(row), dtype=np.int64), 0
    for begin, end in pairwise(edges):
        steady = phase[begin] not in (LOAD, UNLOAD)
        own = _parts(int(end - begin), binning.of_phase(int(phase[begin])), steady)
        bins[begin:end] = own + last
        last += int(own[-1]) + 1
    return bins


def _parts(length: int, most: int, growing: bool) -> IntArray:
    """Return the number (length,) of the part of each frame of a stretch, from 0 without a gap."""
    if length <= most:
        return np.arange(length)
    share = np.arange(1, most) / most
    if growing:
        share = (_GROWTH ** (most * share) - 1) / (_GROWTH**most - 1)
    own = np.searchsorted(share, (np.arange(length) + 0.5) / length)
    return np.unique(own, return_inverse=True)[1].reshape(-1).astype(np.int64)


def of_holds(
    played: HoldSession, counts: FloatArray | None, *, clock: bool, frames: float = 1.0
) -> GapSession:
    """Make a session of hold means.

    Args:
        played: standard presses.
        counts: (H, J) mean images of the holds; None for a plan.
        clock: True if the times of presses were recorded; otherwise effects that need them abstain.
        frames: number of frames that a mean stands for, for its noise.
    """
    samples, presses = played.samples, len(played.hold)
    if not clock:
        samples = replace(samples, time_s=None, phase=None)
    observation = np.full(len(samples), -1)
    observation[played.hold] = np.arange(presses)[:, None]
    own, phase = np.arange(presses), np.full(presses, HOLD)
    many = np.full(presses, frames)
    return GapSession(samples, played.row, observation, own, phase, many, counts, has_frames=False)
