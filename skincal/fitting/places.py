"""All possible contact positions of each press.

Two taxels in a row determine one coordinate of a contact well, and the other only up to its sign: the mirror
image on the other side of the row fits almost as well. Every such position has to be found and counted
exactly once. A missed position, or one that is counted twice, biases the macro variables.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from skincal.fitting.laplace import MERGED, Fold, measure_fold
from skincal.fitting.lattice import minima, square
from skincal.fitting.lookup import compiled
from skincal.fitting.presses import Places, PressModel, PressStates
from skincal.fitting.types import Bools, Floats, Ints
from skincal.model.press.jit import reporting_compilation

SAME_M = 0.03e-3
"""Positions no further apart than this are duplicates."""

SAME_FOLD_M = 0.3e-3
"""The same if both stand at a fold, along which Gauss-Newton converges slowly."""

BLUNT = 0.06
"""Least noise of the lattice search, as a fraction of the typical signal: the response of a taxel to a step of
0.25 mm. With less noise, the search would step over basins."""

FIRST, MOST, MARGIN = 4, 6, 30.0
"""Most positions that are kept per press: from the lattice, and with mirror positions; none whose objective is
``MARGIN`` above the best of the press."""

_STEP_M, _DEEP = 0.25e-3, 200.0
"""Step of the lattice of starts [m], and most by which the objective of a start may exceed the lowest one."""

_APART_M = 0.05e-3
"""Search results no further apart than this are one position."""


def find_duplicates(press: Ints, uv_m: Floats, fold: Fold) -> Bools:
    """Return which positions (W, N) have converged to an earlier position of the same press, and would count twice.

    ``press`` is (N,), ``uv_m`` (W, N, 2), and ``fold`` of W * N positions, for W macro points.
    """
    merged = (fold.a <= MERGED).reshape(uv_m.shape[:2])
    i, j = np.nonzero(np.tril(press[:, None] == press, -1))
    reach = np.where(merged[:, i] & merged[:, j], SAME_FOLD_M, SAME_M)
    twin = np.zeros(uv_m.shape[:2], dtype=bool)
    near = np.abs(uv_m[:, i] - uv_m[:, j]).max(axis=2) < reach
    np.logical_or.at(twin.T, i, near.T)
    return twin


def find_tracked_mirrors(press: Ints, slack_m: Floats, mirror_m: Floats, count: int) -> Bools:
    """Return which positions (count * N,) have their mirror position among the others of the same press.

    ``press`` is (N,); slacks of positions and mirror positions are (count * N, 2), for ``count`` macro points.
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
    """Find all contact positions within the slack that explain each press, for one macro point (5,) and sigmas (6,).

    A lattice of starts finds most of them. The search also starts from mirror positions, as their basins may
    be narrower than the lattice.
    """
    found = _on_lattice(model, macro, sigmas)
    for _ in range(2):
        here = model.fit_nuisance(macro, sigmas, found.press, found.nuisance, iterations=12)
        start = here.nuisance.copy()
        start[:, :2] = measure_fold(model, here).mirror_m
        there = model.fit_nuisance(macro, sigmas, found.press, start, iterations=20)
        found = _distinct(
            PressStates._make(np.concatenate(pair) for pair in zip(here, there, strict=True)), MOST
        )
    return found.places


def _on_lattice(model: PressModel, macro: Floats, sigmas: Floats) -> PressStates:
    """Return the positions that a lattice of starts converges to."""
    count = len(model.problem)
    half = int(model.problem.rig.slack_m / _STEP_M + 1e-9)
    axis = np.arange(-half, half + 1) * _STEP_M
    lattice = square(axis)
    press = np.repeat(np.arange(count), len(lattice))
    start = np.zeros((len(press), 3))
    start[:, :2] = np.tile(lattice, (count, 1))
    # A larger noise keeps the basins wide enough for the lattice.
    blunt = sigmas.copy()
    blunt[1] = max(sigmas[1], 0.02)
    blunt[2] = max(sigmas[2], BLUNT * model.problem.observation.typical_counts)
    rough = model.fit_nuisance(macro, blunt, press, start, iterations=1, to_rest=False, brief=True)
    q = rough.objective.reshape(count, len(axis), len(axis))
    low = (minima(q) & (q - q.min(axis=(1, 2), keepdims=True) < _DEEP)).reshape(-1)
    state = model.fit_nuisance(macro, sigmas, press[low], rough.nuisance[low], iterations=12)
    return _distinct(state, FIRST)


def _distinct(state: PressStates, most: int) -> PressStates:
    """Return each position once, best first, at most ``most`` per press."""
    kept, order = np.empty_like(state.press), np.lexsort((state.objective, state.press))
    with reporting_compilation():
        count = _keep_distinct(order, state.press, state.objective, state.uv_m, most, kept)
    return state.take(kept[:count])


@compiled
def _keep_distinct(
    order: Any, press: Any, objective: Any, uv_m: Any, most: int, kept: Any
) -> int:  # pragma: no cover - compiled
    """Fill ``kept`` with the numbers of the positions to keep, of (N,) in ``order``; return their count."""
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
