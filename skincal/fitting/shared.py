"""Errors that all presses of a session share: gains of the taxels, their levels at rest, a smooth error of positions.

They are linear, or nearly so, and Gaussian: theta = (g, l, b) with

    S_j = S exp(g_j), g ~ N(0, sigma_g²);   rest_j + l_j, l ~ N(0, spread of the levels);   slack_k ~ N(B_k b, sigma_p²)

where B holds the gradient and the curvature of a field over the patch, with no constant (which cannot be told from the
pose), and b ~ N(0, sigma_b²). They are found along with the peak and integrated out of the posterior in closed form:
with the slack and the force of every press eliminated (Schur complement),

    log integral = -Q(theta_0)/2 + G' (H + P)^-1 G / 2 - log|H + P| / 2 + log|P| / 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.fitting.types import Floats

_SMALLEST_SIGMA = 1e-12


@dataclass(frozen=True, eq=False)
class Shared:
    """Values of the shared errors, and what is known of them before.

    Attributes:
        log_gain: (J,) g.
        level: (J,) l [counts].
        field: (2 M,) b, the M functions across, then along [m].
        level_sigma: (J,) what is known of l beforehand, one sigma [counts].
        basis: (K, M) functions of the field at the presses: mean 0, root mean square 1, uncorrelated.
    """

    log_gain: Floats
    level: Floats
    field: Floats
    level_sigma: Floats
    basis: Floats

    @classmethod
    def none(cls, level_sigma: Floats, across_m: Floats, along_m: Floats) -> Shared:
        """No shared error.

        Args:
            level_sigma: (J,) what is known of each level at rest.
            across_m: (K,) measured positions of the presses.
            along_m: (K,) the same along y.
        """
        basis = smooth_basis(across_m, along_m)
        taxels = len(level_sigma)
        return cls(np.zeros(taxels), np.zeros(taxels), np.zeros(2 * int(basis.shape[1])), level_sigma, basis)

    @property
    def theta(self) -> Floats:
        """All of them as one vector (T,)."""
        return np.concatenate([self.log_gain, self.level, self.field])

    def with_theta(self, theta: Floats) -> Shared:
        """The same with other values (T,)."""
        j = len(self.log_gain)
        return Shared(theta[:j], theta[j : 2 * j], theta[2 * j :], self.level_sigma, self.basis)

    def for_presses(self, across_m: Floats, along_m: Floats) -> Shared:
        """For other presses, with a new basis of the field and none in it."""
        basis = smooth_basis(across_m, along_m)
        return Shared(self.log_gain, self.level, np.zeros(2 * int(basis.shape[1])), self.level_sigma, basis)

    @property
    def shift_m(self) -> Floats:
        """(K, 2) smooth error of the positions, as it adds to the slack [m]."""
        return self.basis @ self.field.reshape(2, -1).T

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


def smooth_basis(across_m: Floats, along_m: Floats) -> Floats:
    """Gradient and curvature of a field at presses: (K, M) uncorrelated, mean 0, root mean square 1.

    Functions that the presses cannot tell apart are left out: M is 5 for presses all over a patch, 0 at one place.

    Args:
        across_m: (K,) positions.
        along_m: (K,) positions.
    """
    if len(across_m) == 0:
        return np.zeros((0, 0))
    x, y = across_m - across_m.mean(), along_m - along_m.mean()
    size = max(float(x.std()), float(y.std()), 1e-12)
    x, y = x / size, y / size
    columns: list[Floats] = []
    for raw in (x, y, x * x, x * y, y * y):
        column = raw - raw.mean()
        start = float(np.sqrt((column**2).mean()))
        for other in columns:
            column = column - other * float((column * other).mean())
        left = float(np.sqrt((column**2).mean()))
        # Presses along a line, or few of them, do not tell all functions apart.
        if left > 0.1 * max(start, 0.1) and len(columns) < max(0, len(x) - 6) // 2:
            columns.append(column / left)
    return np.stack(columns, axis=1) if columns else np.zeros((len(x), 0))


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
) -> Floats:
    """Logarithm (W,) of the integral over the shared errors, relative to the integrand at their present values.

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
    root = np.sqrt(p)[..., None]
    mixed = np.concatenate(
        [
            root * np.matmul(gain[..., None] * nuisance_slope, half_inverse),
            root * np.matmul(level[..., None] * nuisance_slope, half_inverse),
            *(
                -root * basis[None, :, :, None] * (stiff[..., None] * half_inverse[:, :, d])[:, :, None]
                for d in range(2)
            ),
        ],
        axis=2,
    )
    flat = mixed.transpose(0, 2, 1, 3).reshape(count, size, -1)
    # What a press's own place and force would still take up, where they are not quite at rest.
    own = np.einsum("wnjd,wnj->wnd", nuisance_slope, residual) + prior_pull
    taken = np.sqrt(p) * np.einsum("wnde,wnd->wne", half_inverse, own)
    g = g - np.matmul(flat, taken.reshape(count, -1, 1))[..., 0]
    hessian -= np.matmul(flat, flat.transpose(0, 2, 1))
    diagonal = np.arange(size)
    hessian[:, diagonal, diagonal] += precision
    sign, log_det = np.linalg.slogdet(hessian)
    step: Floats = np.asarray(np.linalg.solve(hessian, g[..., None])[..., 0], dtype=np.float64)
    value = 0.5 * np.einsum("wt,wt->w", g, step) - 0.5 * log_det + 0.5 * np.log(precision).sum(axis=1)
    value -= 0.5 * (precision * shared.theta**2).sum(axis=1)
    return np.where(sign > 0, value, -np.inf)
