"""The base model's fit from several starts: poses, then places of presses that a wrong start has trapped."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from skincal.effects.samples import HOLD
from skincal.fitting.lattice import minima, square
from skincal.fitting.tasks import Mapper
from skincal.inference.columns import Free
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitted, Fitter, Settled
from skincal.inference.forward import State
from skincal.model.arrays import FloatArray, IntArray, as_floats

_TURNS = (-0.2, 0.0, 0.2)
"""Angles that the search begins at, about the start's own [rad]."""
_LAYER = np.array([C.law_power, 0.0, 0.0, 0.0])
"""From a foundation half of the way to a half-space."""
_LATTICE = np.linspace(-0.8, 0.8, 9)
_NEAR, _MINIMA, _PLACES = np.linspace(-0.5, 0.5, 3), 6, 2
"""Places about one of the best few of a lattice, in its steps; how many of these there are; and of them are tried."""
_OFF = (0.05, 0.02)
"""By so much of its largest value an image is off a step of the lattice from its place, and about the best; smaller
values by less, as their roots are."""


class Task(NamedTuple):
    """A fit to make, here or in another process.

    Attributes:
        fitter: of the session.
        states: it begins at the one that leaves least.
        free: numbers of effects that are free.
        steps: at most.
        to_end: whether it goes on from better places of presses that it has left behind.
    """

    fitter: Fitter
    states: tuple[State, ...]
    free: tuple[Free, ...] = ()
    steps: int = C.last_steps
    to_end: bool = False


def fitted(task: Task) -> Fitted:
    """Makes a fit."""
    fitter, (state, *others) = task.fitter, task.states
    if others:
        state = min(map(fitter.settled, task.states), key=lambda x: x.loss.sum()).state
    fit = fitter.solve(state, task.free, steps=task.steps)
    return placed_anew(fitter, fit) if task.to_end else fit


def base_fit(fitter: Fitter, mapper: Mapper = map, *, known: bool) -> Fitted:
    """Fits the base model, and leaves the robust weights and the scatter of places that belong to it in the fitter.

    Args:
        fitter: of the session.
        mapper: makes fits that do not need each other side by side.
        known: whether the start is a calibration's, which is near the truth.
    """
    begin = fitter.before.start
    part = fitter.forward.of_holds()
    assert part.session.counts is not None
    before = replace(fitter.before, weights=np.ones(part.session.counts.shape))
    best: tuple[float, Fitted] | None = None
    for turn in (0.0,) if known else _TURNS:
        rough = Fitter(part, part.session.counts, before)
        rough.foundation = True
        state = replace(begin, pose=replace(begin.pose, alpha_rad=begin.pose.alpha_rad + turn))
        found = _gone_on(rough, state, 4)
        misfit = _misfit(rough, found)
        if best is None or misfit < best[0]:
            best = misfit, found
    assert best is not None
    state = best[1].state
    # What the rig says of its places is a bound; their own scatter may be less.
    own = float(np.sqrt(np.mean(state.move[:, :2] ** 2)))
    least = float(1 / np.sqrt(fitter.before.move[0]))
    precision = fitter.before.move.copy()
    precision[:2] = 1 / float(np.clip(own, 1e-4, least)) ** 2
    fitter.before = replace(fitter.before, move=precision)
    state = placed(fitter, _gone_on(fitter, state, 2).state)
    # A layer of some millimetres is far from a foundation, and what is missing may hold the fit on the way.
    layer = replace(state, law=state.law - _LAYER)
    found = mapper(fitted, [Task(fitter, (begin,)) for begin in (state, layer)])
    return placed_anew(fitter, min(found, key=Fitted.loss))


def placed_anew(fitter: Fitter, fit: Fitted) -> Fitted:
    """A fit, or one that goes on from better places of presses that it has left behind, if that leaves less."""
    if (better := placed(fitter, fit.state)) is fit.state:
        return fit
    return min(fit, fitter.solve(better, fit.free, steps=C.joint_steps), key=Fitted.loss)


def _gone_on(fitter: Fitter, state: State, rounds: int) -> Fitted:
    """A fit that goes on from better places of presses, with new weights, until it stands still."""
    reweighted(fitter, state)
    found = fitter.solve(state, steps=3)
    for _ in range(rounds - 1):
        if found.state is state:
            break
        state = placed(fitter, found.state)
        reweighted(fitter, state)
        found = fitter.solve(state, steps=3)
    return found


def _misfit(fitter: Fitter, found: Fitted) -> float:
    """Huber's loss of holds, so that fits with other weights can be compared."""
    r = np.abs(raw_residual(fitter, found.state))
    return float(np.nansum(np.where(r < C.huber, r * r / 2, C.huber * r - C.huber**2 / 2)))


def raw_residual(fitter: Fitter, state: State) -> FloatArray:
    """(N, J) residual over the noise, before robust weights."""
    expected, _, variance = fitter.expected(fitter.forward.see(state))
    return (fitter.counts - expected) / np.sqrt(variance)


def reweighted(fitter: Fitter, state: State) -> None:
    """Leaves robust weights in the fitter: residuals beyond a bound count in proportion."""
    size = np.nan_to_num(np.abs(raw_residual(fitter, state)))
    fitter.before = replace(fitter.before, weights=np.sqrt(np.minimum(1.0, C.huber / np.maximum(size, 1e-9))))


def left_of(fitter: Fitter, state: State) -> FloatArray:
    """(P,) mean absolute residual of each press's holds over the noise."""
    r = np.nan_to_num(np.abs(raw_residual(fitter, state)))
    out = np.zeros(fitter.forward.presses)
    for p in range(len(out)):
        rows = (fitter.press == p) & (fitter.phase == HOLD)
        rows = rows if rows.any() else fitter.press == p
        out[p] = r[rows].mean() if rows.any() else 0.0
    return out


def wild_presses(fitter: Fitter, state: State) -> IntArray:
    """Rows of presses whose images are out of all proportion to those of others, if they are few."""
    return out_of_proportion(left_of(fitter, state))


def out_of_proportion(left: FloatArray) -> IntArray:
    """Rows of presses that leave far more (P,) than others, if they are few; 0 is a press that is not seen."""
    known = left > 0
    if not known.any():
        return np.zeros(0, dtype=np.int64)
    found = np.flatnonzero(left > C.wild * np.median(left[known]) + 0.5)
    return found if len(found) <= max(1, int(known.sum()) // 10) else np.zeros(0, dtype=np.int64)


def without_presses(fitter: Fitter, rows: IntArray) -> Fitter:
    """The same fitter that does not see some presses."""
    counts = fitter.counts.copy()
    counts[np.isin(fitter.press, rows)] = np.nan
    return Fitter(fitter.forward, counts, fitter.before)


def with_image_error(fitter: Fitter, state: State) -> Fitter:
    """The same fitter with the error of images that is the likeliest at a state; what is known is the least."""
    seen = fitter.forward.see(state)
    own, none = fitter.equations(seen, word=True)
    w = fitter.whitened(seen, none, own)
    others = [
        Fitter(fitter.forward, fitter.counts, replace(fitter.before, image=x))
        for x in C.image * np.array(C.images)
    ]

    def left(one: Fitter) -> float:
        # Where presses would be best by the error that is tried: by another one they are at other places.
        b = one.blocks(w, state.move)
        return float((b.loss - b.ahead).sum())

    return min(others, key=left)


def placed(fitter: Fitter, state: State) -> State:
    """A state whose presses stand where they leave least: where they are, or where a place of a lattice leads.

    An image may have two places about which a step of any kind leaves more, and a fit bends by what is at the wrong
    one.
    """
    best = here = fitter.settled(state)
    step = fitter.before.slack_m * (_LATTICE[1] - _LATTICE[0])
    for there in placed_at(fitter, state, np.arange(fitter.forward.presses)):
        # Within a step of the lattice it is the place where the press is.
        other = (np.abs(there.move - here.state.move)[:, :2] > step).any(axis=1)[:, None]
        if other.any():
            there = replace(state, move=np.where(other, there.move, here.state.move))
            best = better_of(best, fitter.settled(there))
    gained = (best.loss < here.loss - C.loose)[:-1, None]
    return replace(state, move=np.where(gained, best.state.move, here.state.move)) if gained.any() else state


def better_of(one: Settled, other: Settled) -> Settled:
    """Each press where it leaves less."""
    less = other.loss < one.loss
    move = np.where(less[:-1, None], other.state.move, one.state.move)
    return Settled(replace(one.state, move=move), one.seen, np.minimum(one.loss, other.loss))


def placed_at(fitter: Fitter, state: State, rows: IntArray) -> list[State]:
    """States whose named presses stand at the best places of a lattice within the slack, the next best, and so on.

    A place is one about which all others of the lattice leave more; where there are too few, the best stands for them.
    Few presses are read at a time, as their tables are large; about each place it is looked more finely.
    """
    f = fitter.forward
    images, at = _images(fitter, state, rows)
    own = np.flatnonzero(at >= 0)
    rows, images, at = rows[own], images[own], at[own]
    if not len(rows):
        return []
    read, slack = f.reader(state, at), fitter.before.slack_m
    top = np.maximum(np.nanmax(images, axis=1) - state.rest, 0.0)
    parts = np.array_split(np.arange(len(rows)), len(rows) // 16 + 1)

    def left(grid: FloatArray, part: float) -> FloatArray:
        """(B, m) what presses leave at places (B, m, 2) where images are off by a part of the largest value."""
        levels = f.noise.written(np.concatenate([read(grid[k], k) for k in parts]))[0]
        about = np.maximum((levels + images[:, None]) / 2 - state.rest, 0.0)
        variance = f.noise.frame**2 + part**2 * top[:, None, None] * about
        off = np.nansum((levels - images[:, None]) ** 2 / variance, axis=2)
        return off + (grid**2).sum(axis=2) * fitter.before.move[0]

    grid = as_floats(slack * square(_LATTICE))
    off = left(np.tile(grid, (len(rows), 1, 1)), _OFF[0]).reshape(-1, len(_LATTICE), len(_LATTICE))
    off = np.where(minima(off), off, np.inf).reshape(len(rows), -1)
    order = np.argsort(off, axis=1)[:, :_MINIMA]
    order = np.where(np.isfinite(np.take_along_axis(off, order, axis=1)), order, order[:, :1])
    finer = grid[order][:, :, None] + slack * (_LATTICE[1] - _LATTICE[0]) * square(_NEAR)
    off = left(finer.reshape(len(rows), -1, 2), _OFF[1]).reshape(finer.shape[:3])
    best = np.take_along_axis(finer, np.argmin(off, axis=2)[..., None, None], axis=2)[:, :, 0]
    # The lattice tells rough places apart, and what is about them which of these are the best.
    first = np.argsort(off.min(axis=2), axis=1, kind="stable")
    best = np.take_along_axis(best, first[..., None], axis=1)
    out = []
    for k in range(_PLACES):
        move = state.move.copy()
        move[rows] = np.append(best[:, k], np.zeros((len(rows), 1)), axis=1)
        out.append(replace(state, move=move))
    return out


def _images(fitter: Fitter, state: State, presses: IntArray) -> tuple[FloatArray, IntArray]:
    """(B, J) mean images of presses, and (B,) the sample of each that stands for it; -1 for none."""
    f = fitter.forward
    force = np.nan_to_num(f.samples.contacts.force_n) * f.samples.touching
    mean = f.mean @ force
    images, at = np.full((len(presses), fitter.counts.shape[1]), np.nan), np.full(len(presses), -1)
    for k, p in enumerate(presses.tolist()):
        rows = np.flatnonzero((fitter.press == p) & (fitter.phase == HOLD))
        rows = rows if len(rows) else np.flatnonzero(fitter.press == p)
        if not mean[rows].max(initial=0.0) > 0 or not np.isfinite(fitter.counts[rows]).any():
            continue
        images[k] = np.average(fitter.counts[rows], axis=0, weights=np.maximum(mean[rows], 0.0) + 1e-12)
        own = np.flatnonzero(f.row == p)
        level = float(mean[rows].mean())
        at[k] = own[np.argmin(np.abs(force[own] - level))]
    return images, at
