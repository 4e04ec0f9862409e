"""The integrals over what the macro variables do not contain: the nuisance of each press, and the shared errors.

The nuisance, also where the Laplace approximation breaks down. Over the middle of a taxel, or half-way between
two mirror positions, the whitened residual along the weakest direction of the position is a parabola,

    r(v) = r0 + r1 v + b v^2 / 2,    a = r1^2 / 2b - r0,    Z(a) = integral of exp(-(w^2 - a)^2 / 2) dw.

Its two roots (the mirror positions) merge into one fold as the scale of the model falls; there the Laplace
volume diverges. The curvature along the weakest direction is therefore replaced by the one that gives Z, which
is tabled: for each of the two lobes while they are apart, and for both together from the fold on.

The shared errors of :mod:`skincal.fitting.shared`, in closed form, with slack and force of every press
eliminated (Schur complement):

    log integral = -Q(theta_0)/2 + G' (H + P)^-1 G / 2 - log|H + P| / 2 + log|P| / 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from skincal.fitting.presses import PressModel, PressStates, factor_inverse, solve_small
from skincal.fitting.shared import Shared
from skincal.fitting.types import Bools, Floats, Ints

_STEP_M = 0.06e-3
"""Step of the finite difference for the bend [m]."""
MERGED = 0.02
"""Below this a, the two lobes count as one position."""

_LOW, _HIGH = -8.0, 14.0
"""Range of a that is tabled; asymptotic formulas serve beyond it."""
JOINED_BELOW, ALONE_BELOW = 1.0, 4.0
"""Limits of a for a lobe whose mirror position is not tracked. Up to the first, the lobe counts twice: the log
density between the lobes drops by half a unit at most. Up to the second, the mirror counts by the density
found there. Beyond it, the mirror was left out for good reason."""


@dataclass(frozen=True, eq=False)
class Fold:
    """Bend of the residuals of n presses along the weakest direction of their position.

    Attributes:
        log_volume: (n,) -log|H|/2, the Laplace volume without any bend.
        stiffness: (n,) curvature of Q/2 along the weakest direction, the others eliminated [1/m²].
        along_bend: (n,) the part of it that lies along the bend: r1 squared [1/m²].
        half_bend: (n,) b / 2 [1/m²].
        a: (n,) the argument of Z.
        mirror_m: (n, 2) slack of the mirror position [m].
    """

    log_volume: Floats
    stiffness: Floats
    along_bend: Floats
    half_bend: Floats
    a: Floats
    mirror_m: Floats


def measure_fold(model: PressModel, state: PressStates) -> Fold:
    """Measure the bend of the residuals of fitted presses, by finite differences of their slopes."""
    root, log_laplace = factor_inverse(state.hessian)
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
    # The part of the bend that neither the other direction nor the force can absorb; its norm, and the
    # projections of slope and residual on it.
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


def weigh_untracked_mirrors(model: PressModel, state: PressStates, fold: Fold, tracked: Bools) -> Floats:
    """Return the weight, 0 to 1, of each press's mirror position (n,); 0 where it is ``tracked`` as a position."""
    counts = np.where((fold.a > MERGED) & (fold.a <= JOINED_BELOW) & ~tracked, 1.0, 0.0)
    rows = np.flatnonzero((fold.a > JOINED_BELOW) & (fold.a < ALONE_BELOW) & ~tracked)
    if not len(rows):
        return counts
    here = state.take(rows)
    start = here.nuisance.copy()
    start[:, :2] = fold.mirror_m[rows]
    there = model.fit_nuisance(here.macro, here.sigmas, here.press, start, iterations=6, to_rest=False)
    # If the search returns to the press itself, there is no mirror position: other taxels, or the
    # measured position, exclude it.
    away = np.abs(there.nuisance[:, :2] - here.nuisance[:, :2]).max(axis=1)
    whole = np.abs(fold.mirror_m[rows] - here.nuisance[:, :2]).max(axis=1)
    less = np.maximum(there.objective - here.objective, 0.0)
    counts[rows] = np.where(away > 0.3 * whole, np.exp(-0.5 * less), 0.0)
    return counts


def log_volume(fold: Fold, mirror: Floats) -> Floats:
    """Return the log of the nuisance volume (n,), up to a constant, with the weights of the mirror positions (n,)."""
    # A lobe of weight 1 + m has 1 + m times the volume, so its curvature falls by the square.
    bent = fold.half_bend * _curvature(fold.a) / (1.0 + mirror) ** 2
    corrected = fold.stiffness - fold.along_bend + bent
    return fold.log_volume - 0.5 * np.log(corrected / fold.stiffness)


def _curvature(a: Floats) -> Floats:
    """Return the curvature [b/2] of the Gaussian with the volume of one lobe (a above the fold) or of both."""
    at, lobe, both = _tabled()
    inside = np.where(a > MERGED, np.interp(a, at, lobe), np.interp(a, at, both))
    return np.where(a > _HIGH, 4.0 * a, np.where(a < _LOW, -2.0 * a, inside))


@lru_cache(maxsize=1)
def _tabled() -> tuple[Floats, Floats, Floats]:
    """Return a (N,), and the curvatures (N,) for one lobe and for both."""
    at = np.linspace(_LOW, _HIGH, 881)
    # The integrand is even and decays, so the trapezoidal rule is exact to rounding at this step.
    w = np.linspace(0.0, 6.0, 301)
    # Relative to the residual at the position itself: zero in a lobe, |a| beyond the fold.
    floor = np.where(at < 0, at**2, 0.0)
    integrand = np.exp(-0.5 * ((w**2 - at[:, None]) ** 2 - floor[:, None]))
    z = 2.0 * np.trapezoid(integrand, w, axis=1)
    return at, 8.0 * np.pi / z**2, 2.0 * np.pi / z**2


def sum_by_press(press: Ints, log_mass: Floats) -> tuple[Floats, Floats]:
    """Sum the masses (W, N) of each press's positions; ``press`` (N,) ascends.

    Returns:
        Log (W,) of the product of the sums, and the part (W, N) of each mass in its press's sum.
    """
    first = np.flatnonzero(np.diff(press, prepend=-1))
    each = np.diff(first, append=len(press))
    highest = np.maximum.reduceat(log_mass, first, axis=1)
    part = np.exp(log_mass - np.repeat(highest, each, axis=1))
    mass = np.add.reduceat(part, first, axis=1)
    part /= np.repeat(mass, each, axis=1)
    return (highest + np.log(mass)).sum(axis=1), part


def eliminate_nuisance(
    shared: Shared, state: PressStates, weight: Floats, *, macro: bool = False
) -> tuple[Floats, Floats]:
    """Return gradient (W, T) and Hessian (W, T, T) of Q/2 by the shared errors, with slack and force eliminated.

    The prior precision of the shared errors is not included.

    Args:
        shared: present values.
        state: presses fitted at N positions for W macro points, W * N pairs.
        weight: (W, N) of the positions.
        macro: whether to prepend the five macro variables.
    """
    count, spots = weight.shape
    taxels, press = state.residual.shape[1], state.press[:spots]
    slope, own_slope, level, residual = (
        array.reshape(count, spots, taxels, -1)
        for array in (state.macro_slope, state.nuisance_slope, state.level_slope, state.residual)
    )
    gain, level, residual = slope[..., 4], level[..., 0], residual[..., 0]
    half_inverses = factor_inverse(state.hessian)[0].reshape(count, spots, 3, 3)
    sigmas = state.sigmas[::spots]
    off = state.nuisance.reshape(count, spots, 3) - shared.centre[press]
    basis, stiff, p = shared.basis[press], sigmas[:, :1] ** -2, weight[..., None]
    m, lead = int(basis.shape[1]), 5 if macro else 0
    size = lead + 2 * taxels + 2 * m
    gains = np.arange(taxels, dtype=np.intp) + lead
    levels = gains + taxels
    fields = [slice(size - (2 - d) * m, size - (1 - d) * m) for d in range(2)]
    gradient, hessian = np.zeros((count, size)), np.zeros((count, size, size))
    root = np.sqrt(p)[..., None]  # (W, N, 1, 1)
    weighted = root * half_inverses
    by_own = np.matmul(own_slope, weighted)
    mixed = np.empty((count, size, spots, 3))
    heavy = p[..., None] * slope if macro else slope
    if macro:
        gradient[:, :5] = np.einsum("wnja,wnj->wa", heavy, residual)
        hessian[:, :5, :5] = np.einsum("wnja,wnjb->wab", heavy, slope)
        mixed[:, :5] = np.einsum("wnja,wnjd->wand", slope, by_own)
    for columns, by in ((gains, gain), (levels, level)):
        gradient[:, columns] = np.sum(p * by * residual, axis=1)
        hessian[:, columns, columns] = np.sum(p * by**2, axis=1)
        mixed[:, columns] = (by[..., None] * by_own).transpose(0, 2, 1, 3)
        if macro:
            hessian[:, :5, columns] = np.einsum("wnja,wnj->waj", heavy, by)
            hessian[:, columns, :5] = hessian[:, :5, columns].transpose(0, 2, 1)
    hessian[:, gains, levels] = hessian[:, levels, gains] = np.sum(p * gain * level, axis=1)
    square = stiff[:, :, None] * np.einsum("wn,na,nb->wab", weight, basis, basis)
    for d, at in enumerate(fields):
        gradient[:, at] = -stiff * np.einsum("wn,nm,wn->wm", weight, basis, off[..., d])
        hessian[:, at, at] = square
        mixed[:, at] = -basis.T[None, :, :, None] * (stiff[..., None] * weighted[:, :, d])[:, None]
    flat = mixed.reshape(count, size, -1)
    # Nuisance that is not quite converged leaves a gradient of its own; eliminate it, too.
    own = np.einsum("wnjd,wnj->wnd", own_slope, residual) + off * sigmas[:, None, [0, 0, 1]] ** -2
    taken = np.sqrt(p) * np.einsum("wnde,wnd->wne", half_inverses, own)
    gradient -= np.matmul(flat, taken.reshape(count, -1, 1))[..., 0]
    return gradient, hessian - np.matmul(flat, flat.transpose(0, 2, 1))


def log_integral(shared: Shared, state: PressStates, chance: Floats, alive: Bools) -> Floats:
    """Return the log (W,) of the integral over the shared errors, relative to the integrand at their present values.

    The mean gain is held fixed (:meth:`skincal.fitting.shared.Shared.directions`).

    Args:
        shared: present values.
        state: presses fitted at N positions for W macro points, W * N pairs.
        chance: (W, N) probability of each position of a press.
        alive: (J,) taxels that are read.
    """
    sigmas, taxels = state.sigmas[:: chance.shape[1]], len(alive)
    precision = shared.precision(sigmas[:, 4], sigmas[:, 5])
    g, hessian = eliminate_nuisance(shared, state, chance)
    size = g.shape[1]
    g += precision * shared.theta
    hessian[:, range(size), range(size)] += precision
    # Fix the mean gain by the bordered matrix: |V'HV| = |H| a'H⁻¹a for V orthogonal to the unit vector a.
    # Gains of unread taxels only have their prior precision, which cancels.
    g[:, :taxels][:, ~alive] = 0.0
    mean = np.zeros(size)
    mean[:taxels][alive] = 1.0 / np.sqrt(max(int(alive.sum()), 1))
    sign, log_det = np.linalg.slogdet(hessian)
    right = np.stack([g, np.broadcast_to(mean, g.shape)], axis=2)
    steps: Floats = np.asarray(np.linalg.solve(hessian, right), dtype=np.float64)
    own, cross, held = (g * steps[..., 0]).sum(axis=1), steps[..., 0] @ mean, steps[..., 1] @ mean
    sound = (sign > 0) & (held > 0)
    held = np.where(sound, held, 1.0)
    value = 0.5 * (own - cross**2 / held - log_det - np.log(held))
    value += 0.5 * (np.log(precision).sum(axis=1) - np.log(precision[:, 0]))
    value -= 0.5 * (precision * shared.theta**2).sum(axis=1)
    return np.where(sound, value, -np.inf)
