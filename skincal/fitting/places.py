"""All the places where a press could have been.

Two taxels in a row tell one coordinate of a contact well and the other only by its size: a mirror image on the other
side of the row fits almost as well. Every such place has to be found and counted once, and only once: a place that is
missed, or counted twice, weighs the macro variables for which it is there against those for which it is not.
"""

from __future__ import annotations

import numpy as np

from skincal.fitting.lattice import minima, square
from skincal.fitting.presses import Places, PressModel, PressStates, to_patch
from skincal.fitting.types import Bools, Floats, Ints
from skincal.fitting.volume import MERGED, Fold, fold_of

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
    twin = np.zeros(uv_m.shape[:2], dtype=bool)
    for i in range(1, len(press)):
        for j in range(i - 1, -1, -1):
            if press[j] != press[i]:
                break
            reach = np.where(merged[:, i] & merged[:, j], SAME_FOLD_M, SAME_M)
            twin[:, i] |= np.abs(uv_m[:, i] - uv_m[:, j]).max(axis=1) < reach
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
    found = np.zeros((count, spots), dtype=bool)
    for i in range(spots):
        for j in np.flatnonzero(press == press[i]):
            if i != j:
                found[:, i] |= np.abs(slack[:, j] - mirror[:, i]).max(axis=1) < reach[:, i]
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
    problem = model.problem
    press, nuisance = _on_lattice(model, macro, sigmas)
    for _ in range(2):
        here = model.settle(macro, sigmas, press, nuisance, iterations=12)
        start = here.nuisance.copy()
        start[:, :2] = fold_of(model, here).mirror_m
        there = model.settle(macro, sigmas, press, start, iterations=20)
        both = PressStates._make(np.concatenate(pair) for pair in zip(here, there, strict=True))
        press, nuisance = _distinct(both, len(problem), MOST)
    across = problem.across_m[press] + nuisance[:, 0] - macro[0]
    along = problem.along_m[press] + nuisance[:, 1] - macro[1]
    return Places(press, to_patch(across, along, macro[2]), nuisance[:, 2])


def _on_lattice(model: PressModel, macro: Floats, sigmas: Floats) -> tuple[Ints, Floats]:
    """Press (N,) and nuisance (N, 3) of the places that a lattice of starts leads to."""
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
    return _distinct(state, count, FIRST)


def _distinct(state: PressStates, count: int, most: int) -> tuple[Ints, Floats]:
    """Press (N,) and nuisance (N, 3) of places of ``count`` presses, each once, best first, ``most`` a press."""
    kept: list[int] = []
    for k in range(count):
        mine: list[int] = []
        for i in sorted(np.flatnonzero(state.press == k), key=lambda i: state.objective[i]):
            if state.objective[i] > state.objective[mine[0] if mine else i] + MARGIN or len(mine) == most:
                break
            if all(np.abs(state.uv_m[i] - state.uv_m[m]).max() > _APART_M for m in mine):
                mine.append(int(i))
        kept += mine
    return state.press[kept], state.nuisance[kept]
