"""Starts of the base model's fit: several poses, then other places for presses that a wrong pose has trapped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from skincal.effects.samples import HOLD
from skincal.fitting.lattice import minima, square
from skincal.fitting.tasks import Mapper
from skincal.inference.columns import FreeParameter
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitted, Fitter, ProfiledState
from skincal.inference.forward import Forward, State
from skincal.inference.paths import LEAST_M
from skincal.inference.session import GapSession
from skincal.model.arrays import FloatArray, IntArray, as_floats

_TURNS = (-0.2, 0.0, 0.2)
"""Starts of alpha, relative to the given one [rad]."""
_LAYER = np.array([C.law_power, 0.0, 0.0, 0.0])
"""Contact law half way from a foundation to a half-space."""
_LATTICE = np.linspace(-0.8, 0.8, 9)
_NEAR, _MINIMA, _PLACES = np.linspace(-0.5, 0.5, 3), 6, 2
"""Finer lattice about a minimum [lattice steps], number of minima refined, and number of places tried."""
_FOLLOWED = (1.0, 0.5, 0.0)
"""Parts of the measured motion of a contact within its press that are tried."""
_OFF = (0.05, 0.02)
"""Image error on the coarse and on the finer lattice, relative to the largest value; errors of smaller values shrink
with their square root."""


class FitTask(NamedTuple):
    """A fit to make, in this process or another.

    Attributes:
        fitter: of the session.
        states: to begin at; the one with the least loss is used.
        free: run_fit numbers of effects.
        steps: at most.
        to_end: True to continue from better places of presses.
    """

    fitter: Fitter
    states: tuple[State, ...]
    free: tuple[FreeParameter, ...] = ()
    steps: int = C.last_steps
    to_end: bool = False


def run_fit(task: FitTask) -> Fitted:
    """Run a fit."""
    fitter, (state, *others) = task.fitter, task.states
    if others:
        state = min(map(fitter.profile_presses, task.states), key=lambda x: x.loss.sum()).state
    fit = fitter.solve(state, task.free, steps=task.steps)
    return refit_placed(fitter, fit) if task.to_end else fit


def fit_base(fitter: Fitter, mapper: Mapper = map, *, start_is_calibrated: bool) -> Fitted:
    """Fit the base model; leaves its robust weights and scatter of places in the fitter.

    Args:
        fitter: of the session.
        mapper: runs independent fits side by side.
        start_is_calibrated: whether the fit starts from a calibration, which is near the truth; else it tries several
            turns of the sensor.
    """
    begin = fitter.priors.start
    part = fitter.forward.of_holds()
    assert part.session.counts is not None
    before = replace(fitter.priors, weights=np.ones(part.session.counts.shape))
    best: tuple[float, Fitted] | None = None
    for turn in (0.0,) if start_is_calibrated else _TURNS:
        rough = Fitter(part, part.session.counts, before)
        rough.foundation = True
        state = replace(begin, pose=replace(begin.pose, alpha_rad=begin.pose.alpha_rad + turn))
        found = _alternate(rough, state, 4)
        misfit = _misfit(rough, found)
        if best is None or misfit < best[0]:
            best = misfit, found
    assert best is not None
    state = best[1].state
    # The slack of the rig bounds the scatter of places from above.
    own = float(np.sqrt(np.mean(state.move[:, :2] ** 2)))
    least = float(1 / np.sqrt(fitter.priors.move[0]))
    precision = fitter.priors.move.copy()
    precision[:2] = 1 / float(np.clip(own, 1e-4, least)) ** 2
    fitter.priors = replace(fitter.priors, move=precision)
    state = relocate_presses(fitter, _alternate(fitter, state, 2).state)
    # A layer of some millimetres is far from a foundation, and a missing effect may stop the fit on the way.
    layer = replace(state, law=state.law - _LAYER)
    found = mapper(run_fit, [FitTask(fitter, (begin,)) for begin in (state, layer)])
    return refit_placed(fitter, min(found, key=Fitted.loss))


def session_as_shown(fitter: Fitter, others: Callable[[GapSession], Forward]) -> GapSession:
    """Return the session with as much of each contact's measured motion within its press as the images show.

    Joints that give way move the measured contact with the force, whether the true one follows or not.

    Args:
        fitter: of all presses.
        others: makes the model of a session with other paths.
    """
    f = fitter.forward
    if np.abs(f.within_m).max(initial=0.0) < LEAST_M:
        return f.session
    state, losses = relocate_presses(fitter, fitter.priors.start), list[FloatArray]()
    for part in _FOLLOWED:
        other = others(f.session_with_paths(np.full(f.presses, part))) if part < 1 else f
        losses.append(Fitter(other, fitter.counts, fitter.priors).profile_presses(state).loss[:-1])
    return f.session_with_paths(np.array(_FOLLOWED)[np.argmin(losses, axis=0)])


def refit_placed(fitter: Fitter, fit: Fitted) -> Fitted:
    """Return a fit, or one continued from better places of presses if that has less loss."""
    if (better := relocate_presses(fitter, fit.state)) is fit.state:
        return fit
    return min(fit, fitter.solve(better, fit.free, steps=C.joint_steps), key=Fitted.loss)


def _alternate(fitter: Fitter, state: State, rounds: int) -> Fitted:
    """Alternate fits, better places of presses and robust weights until nothing changes."""
    update_weights(fitter, state)
    found = fitter.solve(state, steps=3)
    for _ in range(rounds - 1):
        if found.state is state:
            break
        state = relocate_presses(fitter, found.state)
        update_weights(fitter, state)
        found = fitter.solve(state, steps=3)
    return found


def _misfit(fitter: Fitter, found: Fitted) -> float:
    """Return the Huber loss of holds, which compares fits with different weights."""
    r = np.abs(raw_residual(fitter, found.state))
    return float(np.nansum(np.where(r < C.huber, r * r / 2, C.huber * r - C.huber**2 / 2)))


def raw_residual(fitter: Fitter, state: State) -> FloatArray:
    """Return the residual (N, J) over the noise, without robust weights."""
    expected, _, variance = fitter.expected(fitter.forward.predict(state))
    return (fitter.counts - expected) / np.sqrt(variance)


def update_weights(fitter: Fitter, state: State) -> None:
    """Set the fitter's robust weights (Huber's) at a state."""
    size = np.nan_to_num(np.abs(raw_residual(fitter, state)))
    fitter.priors = replace(fitter.priors, weights=np.sqrt(np.minimum(1.0, C.huber / np.maximum(size, 1e-9))))


def press_misfits(fitter: Fitter, state: State) -> FloatArray:
    """Return the mean absolute residual (P,) over the noise of each press's holds."""
    r = np.nan_to_num(np.abs(raw_residual(fitter, state)))
    out = np.zeros(fitter.forward.presses)
    for p in range(len(out)):
        rows = (fitter.press == p) & (fitter.phase == HOLD)
        rows = rows if rows.any() else fitter.press == p
        out[p] = r[rows].mean() if rows.any() else 0.0
    return out


def outlier_presses(fitter: Fitter, state: State) -> IntArray:
    """Return the rows of outlier presses: their images fit far worse than those of others."""
    return outlier_rows(press_misfits(fitter, state))


def outlier_rows(left: FloatArray) -> IntArray:
    """Return the rows of misfits (P,) far above the median, if they are few; 0 is a press without a reading."""
    known = left > 0
    if not known.any():
        return np.zeros(0, dtype=np.int64)
    found = np.flatnonzero(left > C.wild * np.median(left[known]) + 0.5)
    return found if len(found) <= max(1, int(known.sum()) // 10) else np.zeros(0, dtype=np.int64)


def without_presses(fitter: Fitter, rows: IntArray) -> Fitter:
    """Return a fitter that ignores some presses."""
    counts = fitter.counts.copy()
    counts[np.isin(fitter.press, rows)] = np.nan
    return Fitter(fitter.forward, counts, fitter.priors)


def with_image_error(fitter: Fitter, state: State) -> Fitter:
    """Return a fitter with the most likely image error at a state, not less than the prior's."""
    prediction = fitter.forward.predict(state)
    own, none = fitter.equation_errors(prediction, word=True)
    w = fitter.whitened(prediction, none, own)
    others = [
        Fitter(fitter.forward, fitter.counts, replace(fitter.priors, image=x))
        for x in C.image * np.array(C.images)
    ]

    def loss(one: Fitter) -> float:
        # At the best places for the error that is tried, which differ from the present ones.
        b = one.blocks(w, state.move)
        return float((b.loss - b.ahead).sum())

    return min(others, key=loss)


def relocate_presses(fitter: Fitter, state: State) -> State:
    """Move each press to a better place of a lattice, if there is one.

    An image may fit at two places with a barrier between them, and presses at the wrong one bend the fit.
    """
    best = here = fitter.profile_presses(state)
    step = fitter.priors.slack_m * (_LATTICE[1] - _LATTICE[0])
    for there in candidate_placements(fitter, state, np.arange(fitter.forward.presses)):
        # Within a step of the lattice it is the same place.
        other = (np.abs(there.move - here.state.move)[:, :2] > step).any(axis=1)[:, None]
        if other.any():
            there = replace(state, move=np.where(other, there.move, here.state.move))
            best = better_placement(best, fitter.profile_presses(there))
    gained = (best.loss < here.loss - C.loose)[:-1, None]
    return replace(state, move=np.where(gained, best.state.move, here.state.move)) if gained.any() else state


def better_placement(one: ProfiledState, other: ProfiledState) -> ProfiledState:
    """Take each press from the state in which it has less loss."""
    less = other.loss < one.loss
    move = np.where(less[:-1, None], other.state.move, one.state.move)
    return ProfiledState(replace(one.state, move=move), one.prediction, np.minimum(one.loss, other.loss))


def candidate_placements(fitter: Fitter, state: State, rows: IntArray) -> list[State]:
    """Return states with some presses at the best local minimum of a lattice within the slack, at the next best, ...

    Where a press has too few minima the best is repeated. Each minimum is refined on a finer lattice. Few presses are
    predicted at a time, because their tables are large.
    """
    f = fitter.forward
    images, at = _images(fitter, state, rows)
    own = np.flatnonzero(at >= 0)
    rows, images, at = rows[own], images[own], at[own]
    if not len(rows):
        return []
    read, slack = f.predictor_at(state, at), fitter.priors.slack_m
    top = np.maximum(np.nanmax(images, axis=1) - state.rest, 0.0)
    parts = np.array_split(np.arange(len(rows)), len(rows) // 16 + 1)

    def loss(grid: FloatArray, part: float) -> FloatArray:
        """Return the loss (B, m) of presses at places (B, m, 2), for an image error relative to the largest value."""
        levels = f.noise.written(np.concatenate([read(grid[k], k) for k in parts]))[0]
        about = np.maximum((levels + images[:, None]) / 2 - state.rest, 0.0)
        variance = f.noise.frame**2 + part**2 * top[:, None, None] * about
        off = np.nansum((levels - images[:, None]) ** 2 / variance, axis=2)
        return off + (grid**2).sum(axis=2) * fitter.priors.move[0]

    grid = as_floats(slack * square(_LATTICE))
    off = loss(np.tile(grid, (len(rows), 1, 1)), _OFF[0]).reshape(-1, len(_LATTICE), len(_LATTICE))
    off = np.where(minima(off), off, np.inf).reshape(len(rows), -1)
    order = np.argsort(off, axis=1)[:, :_MINIMA]
    order = np.where(np.isfinite(np.take_along_axis(off, order, axis=1)), order, order[:, :1])
    finer = grid[order][:, :, None] + slack * (_LATTICE[1] - _LATTICE[0]) * square(_NEAR)
    off = loss(finer.reshape(len(rows), -1, 2), _OFF[1]).reshape(finer.shape[:3])
    best = np.take_along_axis(finer, np.argmin(off, axis=2)[..., None, None], axis=2)[:, :, 0]
    # The coarse lattice finds the minima; their order is that of the finer one.
    first = np.argsort(off.min(axis=2), axis=1, kind="stable")
    best = np.take_along_axis(best, first[..., None], axis=1)
    out = []
    for k in range(_PLACES):
        move = state.move.copy()
        move[rows] = np.append(best[:, k], np.zeros((len(rows), 1)), axis=1)
        out.append(replace(state, move=move))
    return out


def _images(fitter: Fitter, state: State, presses: IntArray) -> tuple[FloatArray, IntArray]:
    """Return the mean image (B, J) of each press, and the sample (B,) that stands for it; -1 for none."""
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
