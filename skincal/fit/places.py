"""All the places where a press could have been.

Two taxels in a row tell one coordinate of a contact well and the other only by its size: a mirror image on the other
side of the row fits almost as well. Every such place has to be found and counted once, and only once: a place that is
missed, or counted twice, weighs the macro variables for which it is there against those for which it is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.fit.presses import PressStates, distinct, find_modes, settle
from skincal.fit.problem import FitProblem
from skincal.fit.seen import Images, from_patch, to_patch
from skincal.fit.types import Bools, Floats, Ints
from skincal.fit.volume import MERGED, Fold, fold_of

SAME_M = 0.03e-3
"""Places that are no further apart are one."""

SAME_FOLD_M = 0.3e-3
"""The same where both stand at a fold, along which Gauss-Newton converges slowly."""

MOST, MARGIN = 6, 30.0
"""So many places of a press are kept at most, and none whose objective is so much above its best."""


@dataclass(frozen=True, eq=False)
class Places:
    """Where presses could have been: number of the press (N,), patch coordinates (N, 2) [m], force error (N,)."""

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
        sigmas: (3,) sigma_p [m], sigma_f, sigma_n [counts].
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


def settled_twice(press: Ints, uv_m: Floats, fold: Fold) -> Bools:
    """Which places have run into an earlier place of the same press, and would count twice.

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
    """Which places have their mirror place among the other places of the same press.

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
