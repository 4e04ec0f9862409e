"""All the places where a press could have been.

Two taxels in a row tell one coordinate of a contact well and the other only by its size: a mirror image on the other
side of the row fits almost as well. Every such place has to be found and counted once, and only once: a place that is
missed, or counted twice, weighs the macro variables for which it is there against those for which it is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.fitting.presses import PressStates, settle
from skincal.fitting.problem import FitProblem
from skincal.fitting.seen import Images, from_patch, to_patch
from skincal.fitting.types import Bools, Floats, Ints
from skincal.fitting.volume import MERGED, Fold, fold_of

SAME_M = 0.03e-3
"""Places that are no further apart are one."""

SAME_FOLD_M = 0.3e-3
"""The same where both stand at a fold, along which Gauss-Newton converges slowly."""

BLUNT = 0.06
"""Noise, as a part of the usual signal, that a lattice of 0.25 mm steps over: a taxel's response to such a step."""

MOST, MARGIN = 6, 30.0
"""So many places of a press are kept at most, and none whose objective is so much above its best."""


@dataclass(frozen=True, eq=False)
class Places:
    """Possible places of presses: number of the press (N,), patch coordinates (N, 2) [m], force error (N,)."""

    press: Ints
    uv_m: Floats
    force_error: Floats


def starting_nuisance(problem: FitProblem, places: Places, macro: Floats, press: Ints, count: int) -> Floats:
    """Nuisance that keeps a press at its place on the patch when the patch moves."""
    offset = from_patch(np.tile(places.uv_m, (count, 1)), macro[:, 2])
    across = offset[:, 0] + macro[:, 0] - problem.across_m[press]
    along = offset[:, 1] + macro[:, 1] - problem.along_m[press]
    return np.stack([across, along, np.tile(places.force_error, count)], axis=1)


def find_places(problem: FitProblem, images: Images, macro: Floats, sigmas: Floats) -> Places:
    """All places within the slack where each press could have been, seen from one macro point.

    A lattice of starts finds most of them; where the images tell a place's mirror place, it is looked for there too,
    as the two basins may be narrower than the lattice.

    Args:
        problem: the presses.
        images: simulated images.
        macro: (5,) macro variables.
        sigmas: (6,) in the order of ``HYPER``.
    """
    press, nuisance = find_modes(problem, images, macro, sigmas)
    for _ in range(2):
        press, nuisance = _with_mirrors(problem, images, macro, sigmas, press, nuisance)
    across = problem.across_m[press] + nuisance[:, 0] - macro[0]
    along = problem.along_m[press] + nuisance[:, 1] - macro[1]
    return Places(press, to_patch(across, along, macro[2]), nuisance[:, 2])


def _with_mirrors(
    problem: FitProblem, images: Images, macro: Floats, sigmas: Floats, press: Ints, nuisance: Floats
) -> tuple[Ints, Floats]:
    many, spreads = np.tile(macro, (len(press), 1)), np.tile(sigmas, (len(press), 1))
    here = settle(problem, images, many, spreads, press, nuisance, iterations=12)
    start = here.nuisance.copy()
    start[:, :2] = fold_of(problem, images, many, spreads, press, here).mirror_m
    there = settle(problem, images, many, spreads, press, start, iterations=20)
    both = PressStates(
        *(np.concatenate(pair) for pair in zip(vars(here).values(), vars(there).values(), strict=True))
    )
    return distinct(np.tile(press, 2), both, len(problem), MOST, MARGIN)


def best_of_each(press: Ints, score: Floats, count: int) -> Ints:
    """For each of ``count`` presses the place (of N) whose score (N,) is least; every press has one."""
    order = np.lexsort((score, press))
    return order[np.searchsorted(press[order], np.arange(count))]


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


def find_modes(
    problem: FitProblem,
    images: Images,
    macro: Floats,
    sigmas: Floats,
    *,
    step_m: float = 0.25e-3,
    most: int = 4,
    margin: float = 30.0,
) -> tuple[Ints, Floats]:
    """All places within the slack where a press could have been, at one macro point.

    Two or more taxels in a row tell one coordinate well and the other only by its size: a mirror image on the other
    side of the row fits almost as well. All such places are kept, and weighed later.

    Args:
        problem: the presses.
        images: kernels.
        macro: (5,) macro variables.
        sigmas: (6,) in the order of ``HYPER``.
        step_m: lattice of starts [m].
        most: so many places a press at most.
        margin: places whose objective is so much above the best are left out.

    Returns:
        Number of the press (N,) and nuisance (N, 3) of every place, best first for each press.
    """
    half = int(problem.rig.slack_m / step_m + 1e-9)
    axis = np.arange(-half, half + 1) * step_m
    side, count = len(axis), len(problem)
    lattice = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    press = np.repeat(np.arange(count), len(lattice))
    start = np.zeros((len(press), 3))
    start[:, :2] = np.tile(lattice, (count, 1))
    # A blunt noise keeps the basins wide enough for the lattice.
    blunt = sigmas.copy()
    blunt[1] = max(sigmas[1], 0.02)
    blunt[2] = max(sigmas[2], BLUNT * problem.observation.typical_counts)
    many = np.broadcast_to
    rough = settle(
        problem,
        images,
        many(macro, (len(press), 5)),
        many(blunt, (len(press), len(blunt))),
        press,
        start,
        iterations=1,
        to_rest=False,
        brief=True,
    )
    q = rough.objective.reshape(count, side, side)
    padded = np.pad(q, ((0, 0), (1, 1), (1, 1)), constant_values=np.inf)
    around = np.stack(
        [
            padded[:, 1 + i : 1 + i + side, 1 + j : 1 + j + side]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            if (i, j) != (0, 0)
        ]
    )
    low = (q <= around.min(axis=0)).reshape(-1)
    low &= (q - q.min(axis=(1, 2), keepdims=True)).reshape(-1) < 200.0
    press, start = press[low], rough.nuisance[low]
    sharp = many(sigmas, (len(press), len(sigmas)))
    state = settle(problem, images, many(macro, (len(press), 5)), sharp, press, start, iterations=12)
    return distinct(press, state, count, most, margin)


def distinct(press: Ints, state: PressStates, count: int, most: int, margin: float) -> tuple[Ints, Floats]:
    """Press (N,) and nuisance (N, 3) of settled places, each once, best first for each press.

    Args:
        press: (n,) number of the press of each place.
        state: the places.
        count: of the presses.
        most: so many places a press at most.
        margin: places whose objective is so much above the best are left out.
    """
    kept: list[int] = []
    for k in range(count):
        mine: list[int] = []
        for i in sorted(np.flatnonzero(press == k), key=lambda i: state.objective[i]):
            if state.objective[i] > state.objective[mine[0] if mine else i] + margin or len(mine) == most:
                break
            if all(np.abs(state.uv_m[i] - state.uv_m[m]).max() > 0.05e-3 for m in mine):
                mine.append(int(i))
        kept += mine
    return press[kept], state.nuisance[kept]
