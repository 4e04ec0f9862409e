"""All the places where a press could have been.

Two taxels in a row tell one coordinate of a contact well and the other only by its size: a mirror image on the other
side of the row fits almost as well. Every such place has to be found and counted once, and only once: a place that is
missed, or counted twice, weighs the macro variables for which it is there against those for which it is not.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from skincal.fitting.lattice import minima, square
from skincal.fitting.lookup import compiled
from skincal.fitting.presses import Places, PressModel, PressStates
from skincal.fitting.types import Bools, Floats, Ints
from skincal.fitting.volume import MERGED, Fold, fold_of
from skincal.model.press.jit import reporting_compilation

SAME_M = 0.03e-3
"""Places that are no further apart are one."""

SAME_FOLD_M = 0.3e-3
"""The same where both stand at a fold, along which Gauss-Newton converges slowly."""

BLUNT = 0.06
"""Noise, as a part of the usual signal, that a lattice of 0.25 mm steps over: a taxel's response to such a step."""

FIRST, MOST, MARGIN = 4, 6, 30.0
"""So many places of a press are kept at most, of the lattice and with mirror places, and none whose objective is so
much above its best."""

_STEP_M, _DEEP = 0.25e-3, 200.0
"""Lattice of starts [m], and how far above its least one the objective of a start may be."""

_APART_M = 0.05e-3
"""Places that a search ended at are one where they are no further apart."""


def settled_twice(press: Ints, uv_m: Floats, fold: Fold) -> Bools:
    """Return which places have run into an earlier place of the same press, and would count twice.

    Args:
        press: (N,) number of the press.
        uv_m: (W, N, 2) where the places settled for W macro points.
        fold: the folds there, of W * N places.

    Returns:
        (W, N).
    """
    merged = (fold.a <= MERGED).reshape(uv_m.shape[:2])
    i, j = np.nonzero(np.tril(press[:, None] == press, -1))
    reach = np.where(merged[:, i] & merged[:, j], SAME_FOLD_M, SAME_M)
    twin = np.zeros(uv_m.shape[:2], dtype=bool)
    near = np.abs(uv_m[:, i] - uv_m[:, j]).max(axis=2) < reach
    np.logical_or.at(twin.T, i, near.T)
    return twin


def mirrored(press: Ints, slack_m: Floats, mirror_m: Floats, count: int) -> Bools:
    """Return which places have their mirror place among the other places of the same press.

    Args:
        press: (N,) number of the press.
        slack_m: (count * N, 2) slack of the places [m].
        mirror_m: (count * N, 2) slack of the mirror places [m].
        count: of the macro points.

    Returns:
        (count * N,).
    """
    spots = len(press)
    slack, mirror = slack_m.reshape(count, spots, 2), mirror_m.reshape(count, spots, 2)
    reach = 0.3 * np.abs(mirror - slack).max(axis=2) + SAME_M
    i, j = np.nonzero((press[:, None] == press) & ~np.eye(spots, dtype=bool))
    found = np.zeros((count, spots), dtype=bool)
    near = np.abs(slack[:, j] - mirror[:, i]).max(axis=2) < reach[:, i]
    np.logical_or.at(found.T, i, near.T)
    return found.reshape(-1)


def find_places(model: PressModel, macro: Floats, sigmas: Floats) -> Places:
    """All places within the slack where each press could have been, seen from one macro point.

    A lattice of starts finds most of them; where the images tell a place's mirror place, it is looked for there too,
    as the two basins may be narrower than the lattice.

    Args:
        model: the presses.
        macro: (5,) macro variables.
        sigmas: (6,) in the order of ``HYPER``.
    """
    found = _on_lattice(model, macro, sigmas)
    for _ in range(2):
        here = model.settle(macro, sigmas, found.press, found.nuisance, iterations=12)
        start = here.nuisance.copy()
        start[:, :2] = fold_of(model, here).mirror_m
        there = model.settle(macro, sigmas, found.press, start, iterations=20)
        found = _distinct(
            PressStates._make(np.concatenate(pair) for pair in zip(here, there, strict=True)), MOST
        )
    return found.places


def _on_lattice(model: PressModel, macro: Floats, sigmas: Floats) -> PressStates:
    """The places that a lattice of starts leads to."""
    count = len(model.problem)
    half = int(model.problem.rig.slack_m / _STEP_M + 1e-9)
    axis = np.arange(-half, half + 1) * _STEP_M
    lattice = square(axis)
    press = np.repeat(np.arange(count), len(lattice))
    start = np.zeros((len(press), 3))
    start[:, :2] = np.tile(lattice, (count, 1))
    # A blunt noise keeps the basins wide enough for the lattice.
    blunt = sigmas.copy()
    blunt[1] = max(sigmas[1], 0.02)
    blunt[2] = max(sigmas[2], BLUNT * model.problem.observation.typical_counts)
    rough = model.settle(macro, blunt, press, start, iterations=1, to_rest=False, brief=True)
    q = rough.objective.reshape(count, len(axis), len(axis))
    low = (minima(q) & (q - q.min(axis=(1, 2), keepdims=True) < _DEEP)).reshape(-1)
    state = model.settle(macro, sigmas, press[low], rough.nuisance[low], iterations=12)
    return _distinct(state, FIRST)


def _distinct(state: PressStates, most: int) -> PressStates:
    """Each place once, best first, ``most`` a press."""
    kept, order = np.empty_like(state.press), np.lexsort((state.objective, state.press))
    with reporting_compilation():
        count = _keep_distinct(order, state.press, state.objective, state.uv_m, most, kept)
    return state.some(kept[:count])


@compiled
def _keep_distinct(
    order: Any, press: Any, objective: Any, uv_m: Any, most: int, kept: Any
) -> int:  # pragma: no cover - compiled
    """Fill ``kept`` with the numbers of places to keep, of places (N,) in ``order``; return how many they are."""
    count = first = 0
    for n in range(len(order)):
        i = order[n]
        if n == 0 or press[i] != press[order[n - 1]]:
            first = count
        own = count - first
        if own == most or (own > 0 and objective[i] > objective[kept[first]] + MARGIN):
            continue
        apart = True
        for m in range(first, count):
            u, v = uv_m[i, 0] - uv_m[kept[m], 0], uv_m[i, 1] - uv_m[kept[m], 1]
            apart = apart and max(abs(u), abs(v)) > _APART_M
        if apart:
            kept[count] = i
            count += 1
    return count
