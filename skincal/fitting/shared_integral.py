"""The integral over the errors that presses share, :mod:`skincal.fitting.shared`, in closed form.

With the slack and the force of every press eliminated (Schur complement),

    log integral = -Q(theta_0)/2 + G' (H + P)^-1 G / 2 - log|H + P| / 2 + log|P| / 2.
"""

from __future__ import annotations

import numpy as np

from skincal.fitting.presses import PressStates, half_inverse
from skincal.fitting.shared import Shared
from skincal.fitting.types import Bools, Floats


def log_integral(shared: Shared, state: PressStates, chance: Floats, alive: Bools) -> Floats:
    """Logarithm (W,) of the integral over the shared errors, relative to the integrand at their present values.

    The mean of the gains is held, as the scale is that of the taxels as they are
    (:meth:`skincal.fitting.shared.Shared.directions`).

    Args:
        shared: present values.
        state: presses settled at N places for W macro points, W * N pairs.
        chance: (W, N) probability of each place of a press.
        alive: (J,) taxels that are read.
    """
    count, spots = chance.shape
    gain, level, residual = (
        array.reshape(count, spots, -1)
        for array in (state.macro_slope[:, :, 4], state.level_slope, state.residual)
    )
    taxels, press = gain.shape[2], state.press[:spots]
    nuisance_slope = state.nuisance_slope.reshape(count, spots, taxels, 3)
    half_inverses = half_inverse(state.hessian)[0].reshape(count, spots, 3, 3)
    sigmas = state.sigmas[::spots]
    off = state.nuisance.reshape(count, spots, 3) - shared.centre[press]
    precision = shared.precision(sigmas[:, 4], sigmas[:, 5])
    basis = shared.basis[press]
    m = int(basis.shape[1])
    p = chance[..., None]
    gradient = [np.sum(p * gain * residual, axis=1), np.sum(p * level * residual, axis=1)]
    stiff = sigmas[:, :1] ** -2
    gradient += [-stiff * np.einsum("wn,nm,wn->wm", chance, basis, off[..., d]) for d in range(2)]
    g = np.concatenate(gradient, axis=1) + precision * shared.theta
    size = 2 * taxels + 2 * m
    hessian = np.zeros((count, size, size))
    rows = np.arange(taxels)
    hessian[:, rows, rows] = np.sum(p * gain**2, axis=1)
    hessian[:, taxels + rows, taxels + rows] = np.sum(p * level**2, axis=1)
    cross = np.sum(p * gain * level, axis=1)
    hessian[:, rows, taxels + rows] = cross
    hessian[:, taxels + rows, rows] = cross
    square = stiff[:, :, None] * np.einsum("wn,na,nb->wab", chance, basis, basis)
    for d in range(2):
        at = slice(2 * taxels + d * m, 2 * taxels + (d + 1) * m)
        hessian[:, at, at] = square
    root = np.sqrt(p)[..., None]  # (W, N, 1, 1)
    weighted = root * half_inverses
    by_own = np.matmul(nuisance_slope, weighted)
    mixed = np.empty((count, size, spots, 3))
    mixed[:, :taxels] = (gain[..., None] * by_own).transpose(0, 2, 1, 3)
    mixed[:, taxels : 2 * taxels] = (level[..., None] * by_own).transpose(0, 2, 1, 3)
    for d in range(2):
        mixed[:, 2 * taxels + d * m : 2 * taxels + (d + 1) * m] = (
            -basis.T[None, :, :, None] * (stiff[..., None] * weighted[:, :, d])[:, None]
        )
    flat = mixed.reshape(count, size, -1)
    # What a press's own place and force would still take up, where they are not quite at rest.
    own = np.einsum("wnjd,wnj->wnd", nuisance_slope, residual) + off * sigmas[:, None, [0, 0, 1]] ** -2
    taken = np.sqrt(p) * np.einsum("wnde,wnd->wne", half_inverses, own)
    g = g - np.matmul(flat, taken.reshape(count, -1, 1))[..., 0]
    hessian -= np.matmul(flat, flat.transpose(0, 2, 1))
    hessian[:, range(size), range(size)] += precision
    # With the mean gain held, by the bordered matrix: |V'HV| = |H| a'H⁻¹a for V orthogonal to the unit vector a. Gains
    # that nothing reads have their own precision alone, and drop out.
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
