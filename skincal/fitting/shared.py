"""Errors that all presses of a session share: gains of the taxels, their levels at rest, a smooth error of positions.

They are linear, or nearly so, and Gaussian: theta = (g, l, b) with

    S_j = S exp(g_j), g ~ N(0, sigma_g²);   rest_j + l_j, l ~ N(0, spread of the levels);   slack_k ~ N(B_k b, sigma_p²)

where B holds the gradient and the curvature of a field over the patch and its change with force and posture, with no
constant (which cannot be told from the pose), and b ~ N(0, sigma_b²). They are found along with the peak and integrated
out of the posterior in closed form (:mod:`skincal.fitting.shared_integral`).
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
    def centre(self) -> Floats:
        """(K, 3) slack [m] and force error about which the presses' own are scattered."""
        return np.column_stack([self.shift_m, np.zeros(len(self.basis))])

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
