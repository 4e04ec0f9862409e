"""The evidence of presses by a mixture of narrow slacks: what Laplace's approximation misses.

A press may lie anywhere along a thin curved sheet: over the middle of a taxel, or on a ring round it where one taxel
alone answers. There Laplace's approximation, even with the fold of :mod:`skincal.fitting.volume`, is off by some tenths
of a unit a press, always to the same side, and sixty presses together draw E by half of its standard deviation.

A Gaussian slack is a mixture of narrower ones on a lattice,

    N(s; 0, sigma_p²) = sum_c h² N(c; 0, sigma_p² - omega²) N(s; c, omega²),

to 3e-4 for h = 1.5 omega. Within each the image hardly bends, and Laplace's approximation is right. This costs twice
as much as the places of :mod:`skincal.fitting.places`, and more with the errors that presses share. So it is done for
some of the draws only, and what it adds to the log posterior, a smooth function of the parameters, is fitted to these
and added to all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.fitting.places import Places, starting_nuisance
from skincal.fitting.presses import PressStates, evaluate, half_inverse, settle
from skincal.fitting.problem import FitProblem
from skincal.fitting.seen import Images
from skincal.fitting.types import Floats, Ints
from skincal.fitting.volume import fold_of

SPACING = 1.5
"""Distance of the narrow slacks, in their standard deviation: the mixture is then even to 3e-4."""

BEND = 0.3
"""A narrow slack bends the whitened residual by so much: the slope of a session's log evidence by log E is then within
3 of what those of half of it give, a tenth of a standard deviation; those of twice of it are off by 7."""

WIDEST, NARROWEST = 0.6, 0.06
"""Standard deviation of the narrow slacks in parts of the wide one, at most and at least."""

REACH = 3.3
"""Slacks are looked for up to so many standard deviations."""

MARGIN = 7.0
"""Narrow slacks whose evidence is so much below the press's best one count for nothing."""

_STEPS = 4
_STEP = 0.3
"""Places are moved by this part of the narrow slack for the bend of the residual."""
_FLATTEST = 0.1
"""A curvature is at least this part of Gauss-Newton's."""


@dataclass(frozen=True, eq=False)
class NarrowSlacks:
    """The narrow slacks (N,) that count, of all presses.

    Attributes:
        press: (N,) number of the press.
        centre_m: (N, 2) where each lies [m].
        omega_m: (N,) its standard deviation [m].
        at: where each settled at the macro point it was found for.
    """

    press: Ints
    centre_m: Floats
    omega_m: Floats
    at: Places


def find_narrow_slacks(
    problem: FitProblem, images: Images, places: Places, macro: Floats, sigmas: Floats
) -> NarrowSlacks:
    """The narrow slacks that count at one macro point.

    Args:
        problem: the presses.
        images: simulated images.
        places: where each press could have been.
        macro: (5,) macro variables.
        sigmas: (6,) in the order of ``HYPER``.
    """
    width, bend = sigmas[0], _bends(problem, images, places, macro, sigmas)
    omega = np.clip(np.sqrt(BEND / np.maximum(bend, 1e-30)), NARROWEST * width, WIDEST * width)
    found = [
        _of_press(problem, images, macro, sigmas, k, float(one)) for k, one in enumerate(np.asarray(omega))
    ]
    places_of = [one.at for one in found]
    return NarrowSlacks(
        np.concatenate([one.press for one in found]),
        np.concatenate([one.centre_m for one in found]),
        np.concatenate([one.omega_m for one in found]),
        Places(
            np.concatenate([at.press for at in places_of]),
            np.concatenate([at.uv_m for at in places_of]),
            np.concatenate([at.force_error for at in places_of]),
        ),
    )


def _of_press(
    problem: FitProblem, images: Images, macro: Floats, sigmas: Floats, k: int, omega_m: float
) -> NarrowSlacks:
    """The narrow slacks of press ``k`` that count: one press at a time, as they are many before they are chosen."""
    reach, step = REACH * float(sigmas[0]), SPACING * omega_m
    half = int(np.ceil(reach / step))
    axis: Floats = np.arange(-half, half + 1, dtype=np.float64) * step
    across, along = np.meshgrid(axis, axis, indexing="ij")
    lattice = np.column_stack([across.ravel(), along.ravel()])
    lattice = lattice[np.hypot(lattice[:, 0], lattice[:, 1]) <= reach]
    press = np.full(len(lattice), k, dtype=np.intp)
    none = Places(press, np.empty((0, 2)), np.empty(0))
    every = NarrowSlacks(press, lattice, np.full(len(press), omega_m), none)
    start = np.column_stack([lattice + problem.shared.shift_m[press], np.zeros(len(press))])
    evidence, at = _evidence(problem, images, macro, sigmas, every, start)
    kept = evidence > evidence.max() - MARGIN
    chosen = Places(press[kept], at.uv_m[kept], at.force_error[kept])
    return NarrowSlacks(press[kept], lattice[kept], every.omega_m[kept], chosen)


def _bends(problem: FitProblem, images: Images, places: Places, macro: Floats, sigmas: Floats) -> Floats:
    """Second derivatives (K,) of the whitened residuals by the place [1/m²], about the largest of each press."""
    many, spreads = np.tile(macro, (len(places.press), 1)), np.tile(sigmas, (len(places.press), 1))
    start = starting_nuisance(problem, places, many, places.press, 1)
    state = settle(problem, images, many, spreads, places.press, start)
    weak = 2.0 * fold_of(problem, images, many, spreads, places.press, state).half_bend
    bend = np.zeros(len(problem))
    np.maximum.at(bend, places.press, weak)
    # Where the weakest direction happens to be straight, another one bends as images of a taxel's size do.
    spread = np.sqrt(problem.observation.variance(spreads[:, 2], spreads[:, 3], places.press))
    bright = (state.simulated / spread).max(axis=1) / float(np.median(problem.rig.layout.sizes_m)) ** 2
    np.maximum.at(bend, places.press, bright)
    return bend


def log_evidence(problem: FitProblem, images: Images, slacks: NarrowSlacks, points: Floats) -> Floats:
    """Log evidence (W,) of all presses, up to a constant: the one of :func:`skincal.fitting.posterior.press_evidence`.

    Args:
        problem: the presses.
        images: simulated images.
        slacks: that count.
        points: (W, 11) macro variables and logarithms of the sigmas.
    """
    out = np.empty(len(points))
    first = np.flatnonzero(np.diff(slacks.press, prepend=-1))
    for n, point in enumerate(points):
        macro, sigmas = point[:5], np.exp(point[5:])
        many = np.tile(macro, (len(slacks.press), 1))
        start = starting_nuisance(problem, slacks.at, many, slacks.press, 1)
        evidence, _ = _evidence(problem, images, macro, sigmas, slacks, start)
        highest = np.maximum.reduceat(evidence, first)
        parts = np.exp(evidence - np.repeat(highest, np.diff(first, append=len(evidence))))
        out[n] = float((highest + np.log(np.add.reduceat(parts, first))).sum())
    return out


def _evidence(
    problem: FitProblem, images: Images, macro: Floats, sigmas: Floats, slacks: NarrowSlacks, start: Floats
) -> tuple[Floats, Places]:
    """Log evidence (N,) of narrow slacks at one macro point, and where they settled."""
    count, press = len(slacks.press), slacks.press
    spreads = np.tile(sigmas, (count, 1))
    left = np.maximum(sigmas[0] ** 2 - slacks.omega_m**2, (0.1 * sigmas[0]) ** 2)
    spreads[:, 0] = slacks.omega_m
    state = settle(
        problem,
        images,
        np.tile(macro, (count, 1)),
        spreads,
        press,
        start,
        iterations=_STEPS,
        to_rest=False,
        centre=slacks.centre_m + problem.shared.shift_m[press],
    )
    weight = -0.5 * (slacks.centre_m**2).sum(axis=1) / left - np.log(left) - np.log(sigmas[1])
    hessian = _whole_hessian(problem, images, np.tile(macro, (count, 1)), spreads, press, state)
    evidence = -0.5 * state.objective + half_inverse(hessian)[1] + weight
    return evidence, Places(press, state.uv_m, state.nuisance[:, 2])


def _whole_hessian(
    problem: FitProblem, images: Images, macro: Floats, sigmas: Floats, press: Ints, state: PressStates
) -> Floats:
    """Hessians (n, 3, 3) of settled presses with what residuals add by their bend, which Gauss-Newton leaves out.

    A press that reads more or less than its place can give leaves a residual, and a bend of it is part of the curvature
    to first order; over the middle of a taxel all presses have the same sign of it.
    """
    step = _STEP * sigmas[:, 0]
    added = np.zeros_like(state.hessian)
    for d in range(2):
        away = np.zeros_like(state.nuisance)
        away[:, d] = step
        ahead, behind = (
            evaluate(problem, images, macro, sigmas, press, state.nuisance + side * away) for side in (1, -1)
        )
        bend = (ahead.nuisance_slope - behind.nuisance_slope) / (2 * step)[:, None, None]
        added[:, d] = np.einsum("nj,njd->nd", state.residual, bend)
    added[:, 2, :2] = added[:, :2, 2]
    added[:, 0, 1] = added[:, 1, 0] = 0.5 * (added[:, 0, 1] + added[:, 1, 0])
    # Signals grow as exp(f).
    added[:, 2, 2] = np.einsum("nj,nj->n", state.residual, state.nuisance_slope[..., 2])
    whole = state.hessian + added
    # Where a peak is that flat, it is no peak, and Laplace's approximation is as good as none.
    sound = np.linalg.eigvalsh(whole / _scale(state.hessian))[:, 0] > _FLATTEST
    return np.where(sound[:, None, None], whole, state.hessian)


def _scale(hessian: Floats) -> Floats:
    size = np.sqrt(np.einsum("nii->ni", hessian))
    return size[:, :, None] * size[:, None, :]
