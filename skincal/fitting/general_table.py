"""Images of the skin model, tabled press by press round one pose of the sensor.

The likelihood of the continuous part of a fit is evaluated a million times; the skin model is too slow for that, and
its images are not smooth enough to differentiate. Round one pose it is therefore asked once, on a lattice: for every
press its load shares over the contact's place on the patch (u, v), a few turns alpha and a few ratios F/E. Where the
sensor's centre has moved from the tabled one, the image is the one of the same place on the patch,

    phi(u, v; centre) = phi(u, v; centre_0) + (centre - centre_0) . d phi / d centre |_(u, v)

The last term is what a surface that does not look the same everywhere adds; it is found by difference, and is zero on
a cylinder and a plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import convolve1d, maximum_filter
from scipy.special import ive

from skincal.fitting.general_skin import RESOLUTION_M
from skincal.fitting.lookup import keys_weights
from skincal.fitting.problem import FitProblem
from skincal.fitting.seen import Seen, offsets, to_patch, turned_slopes
from skincal.fitting.types import Bools, Floats, Ints

_SILENT = 1e-7
"""A taxel with less than this share of the force at a place is not looked up there."""

_PAIRS = 20_000
"""Taxels looked up at a time, to bound memory."""


@dataclass(frozen=True)
class TableReach:
    """How far a table goes, and how finely.

    Attributes:
        centre_m: how far the sensor's centre may move from the tabled one [m].
        alpha_rad: how far the turn may [rad].
        log_ratio: how far log(F/E) may.
        levels: number of tabled ratios.
        step_m: lattice step on the patch [m].
        resolution_m: cells of the patch [m].
    """

    centre_m: float
    alpha_rad: float
    log_ratio: float
    levels: int = 7
    step_m: float = 0.3e-3
    resolution_m: float = RESOLUTION_M


ROUGH = TableReach(1.2e-3, np.radians(8.0), 0.9, levels=5, step_m=0.5e-3, resolution_m=0.5e-3)
"""From a point of a coarse grid to the peak that belongs to it."""


@dataclass(frozen=True, eq=False)
class SkinTable:
    """Tabled images of K presses.

    Attributes:
        shares: (P, N, N, A * L + 2) float32: share of the force that a taxel reports, for turns and ratios, and its
            derivative by the centre across and along [1/m]; for those taxels of presses that are ever loaded.
        lit: (P, N, N) where there is anything to look up.
        plane: (K, J) which of the P planes belongs to a taxel of a press, or -1.
        anchor_m: (K, 2) patch coordinates of the middle of each press's lattice [m].
        slot: (M,) for every press of the session its row here, or -1.
        log_ratio: (K,) log(F/E) in the middle of the tabled ratios.
        centre: (3,) tabled centre across and along [m], and turn [rad].
        reach: how far the table goes.
    """

    shares: Floats
    lit: Bools
    plane: Ints
    anchor_m: Floats
    slot: Ints
    log_ratio: Floats
    centre: Floats
    reach: TableReach

    def see(self, problem: FitProblem, macro: Floats, press: Ints, nuisance: Floats) -> Seen:
        """See :meth:`skincal.fitting.seen.Images.see`."""
        across, along, log_ratio = offsets(problem, macro, press, nuisance)
        alpha = macro[:, 2]
        uv = to_patch(across, along, alpha)
        slot = self.slot[problem.rows[press]]
        weights = self._weights(macro, log_ratio - self.log_ratio[slot])
        value, by_u, by_v, by_alpha, by_ratio, by_east, by_north = self._look_up(slot, uv, weights)
        by_contact = turned_slopes(by_u, by_v, alpha)
        by_alpha = by_alpha + by_u * uv[:, 1:] - by_v * uv[:, :1]
        by_centre = np.stack([by_east, by_north], axis=-1) - by_contact
        return Seen(uv, value, by_contact, by_centre, by_alpha, by_ratio)

    def holds(self, macro: Floats) -> bool:
        """Whether macro variables (5,) lie well within the table; the ratio F/E is left to its wide margin."""
        away = np.abs(macro[:3] - self.centre)
        reach = np.array([self.reach.centre_m, self.reach.centre_m, self.reach.alpha_rad])
        return bool((away <= 0.8 * reach).all())

    def spread(self, width_m: float) -> SkinTable:
        """The table of a skin that spreads the pressure sideways by a Gaussian [m].

        Pressure that is carried on by d loads a taxel as if the contact lay d further, so the shares are smoothed
        over the place on the patch.
        """
        if width_m <= 0:
            return self
        variance = np.full(2, (width_m / self.reach.step_m) ** 2)
        shares = smoothed(self.shares, variance)
        return replace(self, shares=shares, lit=lit_nodes(shares))

    def _weights(self, macro: Floats, ratio: Floats) -> Floats:
        """Weights (n, C, 5) of the channels for the value, and for its derivatives by alpha, ratio and centre."""
        turn_weight, turn_slope = _spline_weights(turns_of(self.reach), macro[:, 2] - self.centre[2])
        level_weight, level_slope = _spline_weights(levels_of(self.reach), ratio)
        out = np.zeros((len(macro), self.shares.shape[-1], 5), dtype=np.float32)
        for n, (a, b) in enumerate(
            ((turn_weight, level_weight), (turn_slope, level_weight), (turn_weight, level_slope))
        ):
            out[:, :-2, n] = _outer(a, b)
        out[:, -2:, 0] = macro[:, :2] - self.centre[:2]
        out[:, -2:, 3:] = np.eye(2)
        return out

    def _look_up(self, slot: Ints, uv_m: Floats, weights: Floats) -> Floats:
        """Value and derivatives by u, v, alpha, ratio and centre (7, n, J)."""
        side, step = self.shares.shape[1], self.reach.step_m
        place = (uv_m - self.anchor_m[slot]) / step + (side - 1) / 2
        near = np.clip(np.rint(place), 0, side - 1).astype(np.intp)
        plane = self.plane[slot]
        lit = (plane >= 0) & self.lit[plane, near[:, :1], near[:, 1:]]
        n, j = np.nonzero(lit)
        out = np.zeros((7, len(slot), plane.shape[1]))
        flat = self.shares.reshape(-1, self.shares.shape[-1])
        for start in range(0, len(n), _PAIRS):
            i, t = n[start : start + _PAIRS], j[start : start + _PAIRS]
            rows, row_weight, row_slope = keys_weights(place[i, 0].astype(np.float32), side)
            cols, col_weight, col_slope = keys_weights(place[i, 1].astype(np.float32), side)
            corner = (plane[i, t] * side + rows - 1) * side + cols - 1
            taps = flat[corner[:, None] + (side * np.arange(4)[:, None] + np.arange(4)).ravel()]
            spots = np.stack(
                [
                    _outer(row_weight.T, col_weight.T),
                    _outer(row_slope.T, col_weight.T),
                    _outer(row_weight.T, col_slope.T),
                ],
                axis=1,
            )
            got = np.matmul(spots, taps)
            out[:3, i, t] = np.einsum("nsc,nc->sn", got, weights[i, :, 0]) / [[1.0], [step], [step]]
            out[3:, i, t] = np.matmul(got[:, :1], weights[i, :, 1:])[:, 0].T
        return out


def turns_of(reach: TableReach) -> Floats:
    """Tabled turns, from the middle one [rad]."""
    return np.linspace(-reach.alpha_rad, reach.alpha_rad, 3)


def levels_of(reach: TableReach) -> Floats:
    """Tabled log(F/E), from the middle one."""
    return np.linspace(-reach.log_ratio, reach.log_ratio, reach.levels)


def lit_nodes(shares: Floats) -> Bools:
    """Nodes (P, N, N) within reach of whose taps anything is not zero."""
    return maximum_filter(np.abs(shares[..., :-2]).max(axis=-1), size=(1, 5, 5)) > _SILENT


def smoothed(shares: Floats, variance: Floats) -> Floats:
    """Shares (P, N, N, C) smoothed over the place on the patch.

    By the discrete Gaussian (Lindeberg 1990), whose variance is right however narrow it is against the lattice.

    Args:
        shares: on the lattice.
        variance: (2,) along u and v, in squared lattice steps.
    """
    for axis, square in enumerate(variance, start=1):
        if square <= 0:
            continue
        far = int(np.ceil(4 * square**0.5 + 2))
        kernel = np.asarray(ive(np.abs(np.arange(-far, far + 1)), square), dtype=np.float32)
        shares = np.asarray(convolve1d(shares, kernel / kernel.sum(), axis=axis, mode="nearest"))
    return shares


def _spline_weights(knots: Floats, at: Floats) -> tuple[Floats, Floats]:
    """Weights (n, K) of values at knots for a cubic spline (three knots: a parabola) at (n,), and their slopes."""
    spline = CubicSpline(knots, np.eye(len(knots)))
    inside = np.clip(at, knots[0], knots[-1])
    return spline(inside), spline(inside, 1)


def _outer(a: Floats, b: Floats) -> Floats:
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), -1)
