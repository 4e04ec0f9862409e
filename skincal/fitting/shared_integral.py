"""The integral over the shared errors of :mod:`skincal.fitting.shared`, in closed form.

With slack and force of every press eliminated (Schur complement),

    log integral = -Q(theta_0)/2 + G' (H + P)^-1 G / 2 - log|H + P| / 2 + log|P| / 2.
"""

from __future__ import annotations

import numpy as np

from skincal.fitting.presses import PressStates, factor_inverse
from skincal.fitting.shared import Shared
from skincal.fitting.types import Bools, Floats


def eliminate_nuisance(
    shared: Shared, state: PressStates, weight: Floats, *, macro: bool = False
) -> tuple[Floats, Floats]:
    """Return gradient (W, T) and Hessian (W, T, T) of Q/2 by the shared errors, with slack and force eliminated.

    Args:
        shared: present values; their prior precision is not included.
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
