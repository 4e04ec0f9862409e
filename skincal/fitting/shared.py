"""Errors that all presses of a session share: gains of the taxels, their levels at rest, a smooth error of positions.

They are linear, or nearly so, and Gaussian: theta = (g, l, b) with

    S_j = S exp(g_j), g ~ N(0, sigma_g²);   rest_j + l_j, l ~ N(0, spread of the levels);   slack_k ~ N(B_k b, sigma_p²)

where B holds the gradient and the curvature of a field over the patch and its change with force and posture, with no
constant (which cannot be told from the pose), and b ~ N(0, sigma_b²). They are found along with the peak and integrated
out of the posterior in closed form: with the slack and the force of every press eliminated (Schur complement),

    log integral = -Q(theta_0)/2 + G' (H + P)^-1 G / 2 - log|H + P| / 2 + log|P| / 2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skincal.fitting.types import Bools, Floats, Ints

_SMALLEST_SIGMA = 1e-12


@dataclass(frozen=True, eq=False)
class Shared:
    """Values of the shared errors, and what is known of them before.

    Attributes:
        log_gain: (J,) g.
        level: (J,) l [counts].
        field: (2 M,) b, the M functions across, then along [m].
        level_sigma: (J,) what is known of l beforehand, one sigma [counts].
        basis: (K, M) functions of the field at the presses (:func:`smooth_field`).
        fading: (M,) how much each falls, in the mean, when forces fall to half.
    """

    log_gain: Floats
    level: Floats
    field: Floats
    level_sigma: Floats
    basis: Floats
    fading: Floats

    @classmethod
    def none(cls, level_sigma: Floats, basis: Floats, fading: Floats) -> Shared:
        """No shared error.

        Args:
            level_sigma: (J,) what is known of each level at rest.
            basis: (K, M) functions of the field at the presses.
            fading: (M,) how much each falls at half of the force.
        """
        taxels = len(level_sigma)
        return cls(np.zeros(taxels), np.zeros(taxels), np.zeros(2 * len(fading)), level_sigma, basis, fading)

    @property
    def theta(self) -> Floats:
        """All of them as one vector (T,)."""
        return np.concatenate([self.log_gain, self.level, self.field])

    def with_theta(self, theta: Floats) -> Shared:
        """The same with other values (T,)."""
        j = len(self.log_gain)
        return replace(self, log_gain=theta[:j], level=theta[j : 2 * j], field=theta[2 * j :])

    def for_presses(self, keep: Bools) -> Shared:
        """For some of the presses (K,), with none of the field."""
        return replace(self, field=np.zeros_like(self.field), basis=self.basis[keep])

    @property
    def half_force_m(self) -> Floats:
        """(2,) how far the pose that positions tell moves where contacts have half of the force of the holds [m]."""
        return self.field.reshape(2, -1) @ self.fading

    @property
    def shift_m(self) -> Floats:
        """(K, 2) smooth error of the positions, as it adds to the slack [m]."""
        return self.basis @ self.field.reshape(2, -1).T

    def directions(self, alive: Bools) -> Floats:
        """Orthonormal directions (T, T') in which errors are free beside a scale of the taxels as they are.

        Were all gains larger by a factor and the scale smaller by it, no reading would differ. So presses tell the
        scale times the mean gain, ``exp(log S + mean g)``, far better than either; the gains are integrated about that,
        and the mean gain, of which the data say nothing beyond ``N(0, sigma_g² / J)``, goes into the draws of S at the
        end. Integrated over linearised, it would multiply whatever draws the scale aside by how much wider S is.

        Args:
            alive: (J,) taxels that are read.
        """
        taxels, size = len(self.log_gain), len(self.theta)
        out = np.zeros((size, size))
        out[range(taxels, size), range(taxels, size)] = 1.0
        rows = np.flatnonzero(alive)
        # The last right singular vectors of a row of ones are orthonormal and sum to zero.
        contrasts = np.linalg.svd(np.ones((1, len(rows))))[2][1:] if len(rows) else np.zeros((0, 0))
        out[rows, : len(contrasts)] = contrasts.T
        return np.delete(out, range(len(contrasts), taxels), axis=1)

    def precision(self, gain_sigma: Floats, field_sigma: Floats) -> Floats:
        """Diagonal (W, T) of P for sigma_g (W,) and sigma_b (W,)."""
        count, taxels = len(gain_sigma), len(self.log_gain)
        level = np.maximum(self.level_sigma, _SMALLEST_SIGMA)
        ones = np.ones((count, 1))
        return np.concatenate(
            [
                np.repeat(gain_sigma[:, None] ** -2, taxels, axis=1),
                ones * level**-2,
                np.repeat(field_sigma[:, None] ** -2, len(self.field), axis=1),
            ],
            axis=1,
        )


def smooth_field(places: Floats, force_n: Floats, posture: Floats, rows: Ints) -> tuple[Floats, Floats]:
    """Functions of a smooth error of positions: gradient and curvature over the patch, linear in force and joints.

    They have mean 0 and root mean square 1 and are uncorrelated over all presses of the session, not only over those
    that are fitted: the pose as the positions tell it has the mean error of all in it. Presses beyond the fitted ones
    count as at their border. Functions that presses cannot tell apart are left out.

    Args:
        places: (N, 2) measured places of all presses [m]; NaN where not known.
        force_n: (N,) their forces [N].
        posture: (N, Q) their joint angles; Q is 0 where there are none.
        rows: (K,) those that are fitted.

    Returns:
        The functions at the fitted presses (K, M), and how much each falls, in the mean, when forces fall to half (M,).
    """
    found = np.column_stack([places, force_n, posture])
    fitted = found[rows]
    fitted = fitted[:, np.isfinite(fitted).all(axis=0)]
    if fitted.shape[1] < found.shape[1]:
        found, fitted = found[:, :3], found[rows, :3]
    most, columns, kept = max(0, len(rows) - 6) // 2, list[Floats](), list[Floats]()
    fading: list[float] = []
    if most == 0:
        return np.zeros((len(rows), 0)), np.zeros(0)
    everywhere = np.clip(found[np.isfinite(found).all(axis=1)], fitted.min(axis=0), fitted.max(axis=0))
    middle, size = everywhere.mean(axis=0), np.maximum(everywhere.std(axis=0), 1e-12)
    # A place changes by as much in either direction.
    size[:2] = size[:2].max()
    there, here = _raw((everywhere - middle) / size), _raw((fitted - middle) / size)
    for number, (raw, mine) in enumerate(zip(there, here, strict=True)):
        mean = float(raw.mean())
        column, own = raw - mean, mine - mean
        start = float(np.sqrt((column**2).mean()))
        for other, others in zip(columns, kept, strict=True):
            part = float((column * other).mean())
            column, own = column - part * other, own - part * others
        left = float(np.sqrt((column**2).mean()))
        # Presses along a line, or few of them, do not tell all functions apart.
        if left > _APART * max(start, _APART) and len(columns) < most:
            columns.append(column / left)
            kept.append(own / left)
            fading.append(0.5 * float(middle[2] / size[2]) / left if number == _BY_FORCE else 0.0)
    return (np.stack(kept, axis=1) if kept else np.zeros((len(rows), 0))), np.array(fading)


_BY_FORCE = 5
_APART = 0.25
"""What of a function the others do not explain is this part of it at least."""


def _raw(at: Floats) -> list[Floats]:
    """The functions at points (N, 3 + Q): gradient and curvature in place, linear in force and in joint angles."""
    x, y, *others = at.T
    return [x, y, x * x, x * y, y * y, *others]


def integral(
    gain: Floats,
    level: Floats,
    nuisance_slope: Floats,
    residual: Floats,
    half_inverse: Floats,
    slack: Floats,
    prior_pull: Floats,
    position_precision: Floats,
    chance: Floats,
    shared: Shared,
    press: np.ndarray,
    precision: Floats,
    alive: Bools,
) -> Floats:
    """Logarithm (W,) of the integral over the shared errors, relative to the integrand at their present values.

    The mean of the gains is held, as the scale is that of the taxels as they are (:meth:`Shared.directions`).

    Args:
        gain: (W, N, J) derivative of the whitened residuals by g.
        level: (W, N, J) by l.
        nuisance_slope: (W, N, J, 3) by slack and force.
        residual: (W, N, J) whitened residuals.
        half_inverse: (W, N, 3, 3) L with L L' the inverse Hessian of the nuisance.
        slack: (W, N, 2) slack less the field's shift [m].
        prior_pull: (W, N, 3) slack and force error over their variances.
        position_precision: (W,) 1 / sigma_p² [1/m²].
        chance: (W, N) probability of each place of a press.
        shared: present values.
        press: (N,) press of each place.
        precision: (W, T) P.
        alive: (J,) taxels that are read.
    """
    count, taxels = len(gain), int(gain.shape[2])
    basis = shared.basis[press]
    m = int(basis.shape[1])
    p = chance[..., None]
    gradient = [np.sum(p * gain * residual, axis=1), np.sum(p * level * residual, axis=1)]
    stiff = position_precision[:, None]
    gradient += [-stiff * np.einsum("wn,nm,wn->wm", chance, basis, slack[..., d]) for d in range(2)]
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
    weighted = root * half_inverse
    by_own = np.matmul(nuisance_slope, weighted)
    mixed = np.empty((count, size, len(press), 3))
    mixed[:, :taxels] = (gain[..., None] * by_own).transpose(0, 2, 1, 3)
    mixed[:, taxels : 2 * taxels] = (level[..., None] * by_own).transpose(0, 2, 1, 3)
    for d in range(2):
        mixed[:, 2 * taxels + d * m : 2 * taxels + (d + 1) * m] = (
            -basis.T[None, :, :, None] * (stiff[..., None] * weighted[:, :, d])[:, None]
        )
    flat = mixed.reshape(count, size, -1)
    # What a press's own place and force would still take up, where they are not quite at rest.
    own = np.einsum("wnjd,wnj->wnd", nuisance_slope, residual) + prior_pull
    taken = np.sqrt(p) * np.einsum("wnde,wnd->wne", half_inverse, own)
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
