"""Errors that all presses of a session share: gains of the taxels, their rest levels, a smooth error of positions.

They are linear, or nearly so, and Gaussian: theta = (g, l, b) with

    S_j = S exp(g_j), g ~ N(0, sigma_g²);   rest_j + l_j, l ~ N(0, spread of the levels);   slack_k ~ N(B_k b, sigma_p²)

where B holds the gradient and the curvature of a field over the patch and its change with force and posture,
and b ~ N(0, sigma_b²). B has no constant, which the pose would absorb. The shared errors are found along with
the peak, and marginalised in closed form (:mod:`skincal.fitting.laplace`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skincal.fitting.types import Bools, Floats, Ints

PER_FORCE_ERROR = np.array([1.0, -1.0])
"""Change of log E and log S that leaves all images unchanged when all forces are larger by a common factor."""

_SMALLEST_SIGMA = 1e-12
"""Lower bound of the level sigma, against division by zero."""


@dataclass(frozen=True, eq=False)
class Shared:
    """Values of the shared errors, and their priors.

    Attributes:
        log_gain: (J,) g.
        level: (J,) l [counts].
        field: (2 M,) b, the M functions across, then along [m].
        level_sigma: (J,) prior standard deviation of l [counts].
        basis: (K, M) functions of the field at the presses (:func:`smooth_field`).
        fading: (M,) decrease of the mean of each function when forces fall to half.
    """

    log_gain: Floats
    level: Floats
    field: Floats
    level_sigma: Floats
    basis: Floats
    fading: Floats

    @classmethod
    def none(cls, level_sigma: Floats, basis: Floats, fading: Floats) -> Shared:
        """Return shared errors of zero."""
        taxels = len(level_sigma)
        return cls(np.zeros(taxels), np.zeros(taxels), np.zeros(2 * len(fading)), level_sigma, basis, fading)

    @property
    def theta(self) -> Floats:
        """All errors as one vector (T,)."""
        return np.concatenate([self.log_gain, self.level, self.field])

    def with_theta(self, theta: Floats) -> Shared:
        """Return the same with other values (T,)."""
        j = len(self.log_gain)
        return replace(self, log_gain=theta[:j], level=theta[j : 2 * j], field=theta[2 * j :])

    def for_presses(self, keep: Bools) -> Shared:
        """Return the shared errors of some presses (K,), with the field reset to zero."""
        return replace(self, field=np.zeros_like(self.field), basis=self.basis[keep])

    @property
    def centre(self) -> Floats:
        """(K, 3) prior mean of slack [m] and log force error of each press."""
        return np.column_stack([self.shift_m, np.zeros(len(self.basis))])

    @property
    def half_force_m(self) -> Floats:
        """(2,) shift of the pose if it is defined by contacts at half of the holds' force [m]."""
        return self.field.reshape(2, -1) @ self.fading

    @property
    def shift_m(self) -> Floats:
        """(K, 2) smooth error of the positions, as a shift of the slack [m]."""
        return self.basis @ self.field.reshape(2, -1).T

    def directions(self, alive: Bools) -> Floats:
        """Return orthonormal directions (T, T') of the shared errors in which the mean gain is fixed.

        If all gains grew by a factor and the scale fell by it, no reading would change. Presses therefore
        determine the product ``exp(log S + mean g)`` far better than either factor. The gains are
        marginalised with this product fixed. The mean gain, of which the data say nothing beyond ``N(0,
        sigma_g² / J)``, is added to the draws of S at the end. Marginalised over a linearisation instead, it
        would multiply any draw far from the peak by the width of S. ``alive`` (J,) are the taxels that are read.
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
        """Return the prior precision (W, T), a diagonal, for sigma_g (W,) and sigma_b (W,)."""
        count, taxels = len(gain_sigma), len(self.log_gain)
        level = np.maximum(self.level_sigma, _SMALLEST_SIGMA)
        gains = np.repeat(gain_sigma[:, None] ** -2, taxels, axis=1)
        fields = np.repeat(field_sigma[:, None] ** -2, len(self.field), axis=1)
        return np.concatenate([gains, np.ones((count, 1)) * level**-2, fields], axis=1)


def smooth_field(places: Floats, force_n: Floats, posture: Floats, rows: Ints) -> tuple[Floats, Floats]:
    """Return basis functions of a smooth error of positions: gradient and curvature, linear in force and joints.

    They have mean 0 and root mean square 1 (that of force less, where forces hardly differ), and are uncorrelated over
    all presses of the session, not only over the fitted ones: the pose includes the mean error over the session.
    Presses outside the range of the fitted ones count as at its border. Functions that the presses
    cannot separate are left out.

    Args:
        places: (N, 2) measured positions of all presses [m]; NaN if unknown.
        force_n: (N,) their forces [N].
        posture: (N, Q) their joint angles; Q is 0 if there are none.
        rows: (K,) the fitted presses.

    Returns:
        The functions at the fitted presses (K, M), and the decrease of the mean of each when forces fall to
        half (M,).
    """
    found = np.column_stack([places, force_n, posture])
    fitted = found[rows]
    fitted = fitted[:, np.isfinite(fitted).all(axis=0)]
    if fitted.shape[1] < found.shape[1]:
        found, fitted = found[:, :3], found[rows, :3]
    most, columns, kept = max(0, len(rows) - 6) // 2, list[Floats](), list[Floats]()
    fading, sizes = list[float](), list[float]()
    if most == 0:
        return np.zeros((len(rows), 0)), np.zeros(0)
    everywhere = np.clip(found[np.isfinite(found).all(axis=1)], fitted.min(axis=0), fitted.max(axis=0))
    middle, size = everywhere.mean(axis=0), np.maximum(everywhere.std(axis=0), 1e-12)
    size[2] = max(size[2], _FORCES_VARY * middle[2])
    # Use one scale for both directions of the position.
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
        # Presses along a line, or few presses, cannot separate all functions.
        if left > _APART * max(start, _APART) and len(columns) < most:
            columns.append(column / left)
            kept.append(own / left)
            by_force = number == _BY_FORCE
            sizes.append(min(start, 1.0) if by_force else 1.0)
            fading.append(0.5 * float(middle[2] / size[2]) / left * sizes[-1] if by_force else 0.0)
    return (np.stack(kept, axis=1) * sizes if kept else np.zeros((len(rows), 0))), np.array(fading)


_BY_FORCE = 5
"""Number of the function that is linear in force."""
_FORCES_VARY = 0.25
"""Least variation of force relative to its mean over which an error of positions is as large as over places: a prior.
Nearly equal forces would otherwise allow any slope, and with it any pose at other forces."""
_APART = 0.25
"""Least fraction of a function that the earlier functions do not explain."""


def _raw(at: Floats) -> list[Floats]:
    """Return the functions at points (N, 3 + Q): gradient and curvature in place, linear in force and joint angles."""
    x, y, *others = at.T
    return [x, y, x * x, x * y, y * y, *others]
