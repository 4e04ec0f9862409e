"""A session as the diagnosis sees it: what was simulated, and which means of it were observed.

With frames, consecutive frames of one press and phase are averaged to a few bins, which are samples and observations at
once. The rule: at most ``Binning`` bins for each press and phase; loading and unloading are cut evenly, the hold and
the rest after a press into parts that grow by half each, because what is left of the loading fades. A phase that has
fewer frames than bins keeps all of them, so quick ramps are not averaged.

Without frames the samples are those of a standard press (:func:`skincal.effects.hold_session`), and a press has one
observation, the mean of its hold. What happened between presses is then not known, so memory does not reach from one
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
"""By so much each bin of a hold or a rest is longer than the one before."""

_APART_S = 1e6
"""Presses whose memory is not to reach each other are moved so far apart [s]."""


@dataclass(frozen=True)
class Binning:
    """How many bins each phase of a press has at most."""

    load: int = 14
    hold: int = 5
    unload: int = 14
    rest: int = 3

    def of_phase(self, phase: int) -> int:
        """The bound of a phase; an unknown one counts as a hold."""
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
        """The samples for effects with memory: without frames presses lie so far apart that all is forgotten."""
        if self.has_frames or self.samples.time_s is None:
            return self.samples
        number = np.cumsum(np.diff(self.row, prepend=self.row[:1]) != 0)
        # The pause is before the moment of rest that ends a press: after it, loading would seem to last as long.
        number = np.append(number[1:], number[-1:])
        apart = _APART_S * number
        return replace(self.samples, time_s=self.samples.time_s + apart, apart_s=apart)

    def held(self) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """(N,) observations in the hold of a press."""
        return (self.phase == HOLD) & (self.press >= 0)

    def mean_force(self) -> FloatArray:
        """(N,) mean force of the samples of each observation [N]."""
        own = np.flatnonzero(self.observation >= 0)
        force = np.nan_to_num(self.samples.contacts.force_n[own]) * self.samples.touching[own]
        at = self.observation[own]
        return np.bincount(at, force, len(self)) / np.maximum(np.bincount(at, minlength=len(self)), 1)

    def of_holds_alone(self) -> GapSession:
        """The holds of a session of frames, without memory of what was before: enough to find the sensor with."""
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
    """A session of frames, thinned by the rule of this module.

    Args:
        frames: one sample a frame, M of them, with a phase.
        row: (M,) row of the press of each frame, -1 at rest.
        counts: (M, J) images; None where there are none (a plan).
        surface: to which mean places are taken.
        binning: how finely.
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
    """Growing numbers (M,) of the bins that frames fall into."""
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
    """Numbers (length,) of the parts of a stretch, from 0 without a gap."""
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
    """A session of hold means.

    Args:
        played: standard presses.
        counts: (H, J) mean images in the hold; None for a plan.
        clock: whether the times of presses were recorded; else what needs them abstains.
        frames: that a mean stands for, as far as its noise is concerned.
    """
    samples, presses = played.samples, len(played.hold)
    if not clock:
        samples = replace(samples, time_s=None, phase=None)
    observation = np.full(len(samples), -1)
    observation[played.hold] = np.arange(presses)[:, None]
    own, phase = np.arange(presses), np.full(presses, HOLD)
    many = np.full(presses, frames)
    return GapSession(samples, played.row, observation, own, phase, many, counts, has_frames=False)
