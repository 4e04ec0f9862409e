"""The volume of the nuisance that a press leaves open, also where Laplace's approximation breaks down.

Over the middle of a taxel the image does not change to first order, and neither does it where a press lies half-way
between two mirror places. Along the weakest direction of the position the whitened residual is then a parabola,

    r(v) = r0 + r1 v + b v^2 / 2,

not a line, and its two roots (the mirror places) run into one fold as the scale of the model falls, beyond which the
measured value cannot be reached. Laplace's volume diverges at the fold, and pulls the scale towards it. The integral
of exp(-r^2/2) over a parabola depends on one number only, a = r1^2 / 2b - r0 (in noise), through

    Z(a) = integral of exp(-(w^2 - a)^2 / 2) dw,

so it is tabled once, and the curvature along the weakest direction is replaced by the one that gives Z: for each of the
two lobes while they are apart, for both together from the fold on.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from skincal.fitting.presses import PressModel, PressStates, half_inverse, solve_small
from skincal.fitting.types import Bools, Floats

_STEP_M = 0.06e-3
MERGED = 0.02
"""Below this a the two lobes are one place."""

_LOW, _HIGH = -8.0, 14.0
JOINED_BELOW, ALONE_BELOW = 1.0, 4.0
"""A lobe whose mirror place is not tracked counts for both up to the first a: no more than half a unit of the log
density lies between them. Up to the second the mirror counts as what is found there; beyond, it was left out for good
reason."""


@dataclass(frozen=True, eq=False)
class Fold:
    """Bend of the residual of n presses along the weakest direction of their position.

    Attributes:
        log_volume: (n,) -log|H|/2, Laplace's, without any bend.
        stiffness: (n,) curvature of Q/2 along the weakest direction, the rest eliminated [1/m²].
        along_bend: (n,) part of it that lies along the bend: r1 squared [1/m²].
        half_bend: (n,) b / 2 [1/m²].
        a: (n,) the number that Z depends on.
        mirror_m: (n, 2) slack at which the mirror place lies [m].
    """

    log_volume: Floats
    stiffness: Floats
    along_bend: Floats
    half_bend: Floats
    a: Floats
    mirror_m: Floats


def fold_of(model: PressModel, state: PressStates) -> Fold:
    """The fold of settled presses."""
    root, log_laplace = half_inverse(state.hessian)
    a, d = (root[:, :2] ** 2).sum(axis=2).T
    b = (root[:, 0] * root[:, 1]).sum(axis=1)
    angle = 0.5 * np.arctan2(2 * b, a - d)
    cos, sin = np.cos(angle), np.sin(angle)
    weak = np.stack([cos, sin, np.zeros_like(angle)], axis=1)
    stiffness = 1.0 / (a * cos**2 + 2 * b * sin * cos + d * sin**2)
    bend = np.einsum("njd,nd->nj", model.bends(state, _STEP_M * weak), weak) / (2 * _STEP_M)
    slope = np.einsum("njd,nd->nj", state.nuisance_slope, weak)
    residual = state.residual
    strong = np.stack([-weak[:, 1], weak[:, 0]], axis=1)
    across = np.einsum("njd,nd->nj", state.nuisance_slope[:, :, :2], strong)
    others = np.stack([across, state.nuisance_slope[:, :, 2]], axis=-1)
    normal = np.matmul(others.transpose(0, 2, 1), others)
    normal[:, [0, 1], [0, 1]] += 1.0 / state.sigmas[:, :2] ** 2
    taken = solve_small(normal, np.einsum("njd,nj->nd", others, bend))
    # What of the bend neither the other direction nor the force can take up; its size, and the parts along it.
    left = bend - np.einsum("njd,nd->nj", others, taken)
    size = np.sqrt(np.maximum(np.einsum("nj,nj->n", bend, left), 1e-6))
    along = np.einsum("nj,nj->n", slope, left) / size
    offset = np.einsum("nj,nj->n", residual, left) / size
    mirror = state.nuisance[:, :2] - (2 * along / size)[:, None] * weak[:, :2]
    return Fold(
        log_laplace,
        stiffness,
        np.minimum(along**2, stiffness),
        0.5 * size,
        0.5 * along**2 / size - offset,
        mirror,
    )


def untracked(model: PressModel, state: PressStates, fold: Fold, tracked: Bools) -> Floats:
    """Return what the mirror place of each settled press (n,) counts, 0 to 1, where it is not counted on its own.

    Args:
        model: the presses.
        state: settled presses.
        fold: how their residuals bend.
        tracked: (n,) whether the mirror place is among the places.
    """
    counts = np.where((fold.a > MERGED) & (fold.a <= JOINED_BELOW) & ~tracked, 1.0, 0.0)
    rows = np.flatnonzero((fold.a > JOINED_BELOW) & (fold.a < ALONE_BELOW) & ~tracked)
    if not len(rows):
        return counts
    here = state.some(rows)
    start = here.nuisance.copy()
    start[:, :2] = fold.mirror_m[rows]
    there = model.settle(here.macro, here.sigmas, here.press, start, iterations=6, to_rest=False)
    # What comes back has no place of its own there: other taxels, or the rig's measurement, rule it out.
    away = np.abs(there.nuisance[:, :2] - here.nuisance[:, :2]).max(axis=1)
    whole = np.abs(fold.mirror_m[rows] - here.nuisance[:, :2]).max(axis=1)
    less = np.maximum(there.objective - here.objective, 0.0)
    counts[rows] = np.where(away > 0.3 * whole, np.exp(-0.5 * less), 0.0)
    return counts


def log_volume(fold: Fold, mirror: Floats) -> Floats:
    """Logarithm (n,) of the open volume, up to a constant.

    Args:
        fold: how the residual bends.
        mirror: (n,) what the mirror place counts besides, from :func:`untracked`.
    """
    # A lobe that counts 1 + m times has that much more volume: a curvature less by the square.
    bent = fold.half_bend * _curvature(fold.a) / (1.0 + mirror) ** 2
    corrected = fold.stiffness - fold.along_bend + bent
    return fold.log_volume - 0.5 * np.log(corrected / fold.stiffness)


def _curvature(a: Floats) -> Floats:
    """Curvature, in units of b/2, of the Gaussian that has the volume of one lobe (a above the fold) or of both."""
    at, lobe, both = _tabled()
    inside = np.where(a > MERGED, np.interp(a, at, lobe), np.interp(a, at, both))
    return np.where(a > _HIGH, 4.0 * a, np.where(a < _LOW, -2.0 * a, inside))


@lru_cache(maxsize=1)
def _tabled() -> tuple[Floats, Floats, Floats]:
    at = np.linspace(_LOW, _HIGH, 881)
    # The integrand is even and decays: the trapezoidal rule is exact to rounding for steps of half its width.
    w = np.linspace(0.0, 6.0, 301)
    # Relative to the residual at the place itself: none in a lobe, |a| beyond the fold.
    floor = np.where(at < 0, at**2, 0.0)
    integrand = np.exp(-0.5 * ((w**2 - at[:, None]) ** 2 - floor[:, None]))
    z = 2.0 * np.trapezoid(integrand, w, axis=1)
    return at, 8.0 * np.pi / z**2, 2.0 * np.pi / z**2
