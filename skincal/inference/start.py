"""The base model's fit from several starts: poses, then places of presses that a wrong start has trapped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.effects.samples import HOLD
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitted, Fitter
from skincal.inference.forward import State
from skincal.inference.press_table import press_table
from skincal.model.arrays import FloatArray, IntArray

_TURNS = (-0.2, 0.0, 0.2)
"""Angles that the search begins at, about the start's own [rad]."""
_LAYER = np.array([C.law_power, 0.0, 0.0])
"""From a foundation half of the way to a half-space."""
_LATTICE = np.linspace(-0.8, 0.8, 9)


def base_fit(fitter: Fitter, *, known: bool) -> Fitted:
    """Fits the base model, and leaves the robust weights and the scatter of places that belong to it in the fitter.

    Args:
        fitter: of the session.
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
        for _ in range(3):
            reweighted(rough, state)
            state = placed(rough, rough.solve(state, steps=3).state)
        reweighted(rough, state)
        found = rough.solve(state, steps=3)
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
    for _ in range(2):
        reweighted(fitter, state)
        found = fitter.solve(state, steps=3)
        state = placed(fitter, found.state)
    # A layer of some millimetres is far from a foundation, and what is missing may hold the fit on the way.
    fits = [
        fitter.solve(replace(state, law=law), steps=C.last_steps) for law in (state.law, state.law - _LAYER)
    ]
    return min(fits, key=lambda one: one.loss())


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
    left = left_of(fitter, state)
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
    return min(others, key=lambda one: one.blocks(w, state.move).loss.sum())


def placed(fitter: Fitter, state: State) -> State:
    """A state whose presses that leave far more than others stand at the best place of a lattice within the slack."""
    left = left_of(fitter, state)
    bad = (
        np.flatnonzero(left > C.trapped * np.median(left[left > 0]) + 0.2)
        if (left > 0).any()
        else np.zeros(0, int)
    )
    return placed_at(fitter, state, bad) if len(bad) else state


def placed_at(fitter: Fitter, state: State, bad: IntArray) -> State:
    """The same of the presses named."""
    f = fitter.forward
    reach = fitter.before.slack_m
    grid = np.array([(a, b) for a in _LATTICE for b in _LATTICE]) * reach
    skin = f.skin(state)
    e, measured = float(np.exp(state.log_e)), f._measured
    move = state.move.copy()
    every = np.repeat(bad, len(grid))
    some = replace(
        measured, points_m=measured.points_m[every], normals=measured.normals[every],
        indenter=measured.indenter[every], most_n=measured.most_n[every],
    )  # fmt: skip
    table = press_table(
        skin.skin.patch,
        f.surface,
        f.samples.indenters,
        some.moved(f.surface, np.tile(grid, (len(bad), 1))),
        e,
        lattice=False,
    )
    force = np.maximum(np.nan_to_num(f.samples.contacts.force_n), 0.0)
    scale, added = np.exp(state.log_s), np.zeros(fitter.counts.shape)
    if state.effects:
        # What effects do to an image is taken to be the same at other places near by.
        added = f.mean @ (f.see(state).values - f.see(replace(state, effects={})).values)
    for k, p in enumerate(bad):
        rows = np.flatnonzero((fitter.press == p) & (fitter.phase == HOLD))
        rows = rows if len(rows) else np.flatnonzero(fitter.press == p)
        own = (f.mean @ force)[rows]
        if not len(own) or not own.max() > 0:
            continue
        image = np.average((fitter.counts - added)[rows], axis=0, weights=own + 1e-12)
        loads = e * table.at(
            np.arange(k * len(grid), (k + 1) * len(grid)), np.full(len(grid), float(own.mean()) / e)
        )
        mean, _ = f.noise.written(loads * scale + state.rest)
        sd = np.hypot(f.noise.frame, 0.05 * max(float(np.nanmax(image)) - state.rest, 0.0))
        off = np.nansum(((mean - image) / sd) ** 2, axis=1) + (grid**2).sum(axis=1) * fitter.before.move[0]
        move[p] = (*grid[int(np.argmin(off))], 0.0)
    return replace(state, move=move)
