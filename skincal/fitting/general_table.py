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
from scipy.special import ive

from skincal.fitting.general_skin import RESOLUTION_M
from skincal.fitting.lookup import NO_KERNELS, ImageTable, Tables
from skincal.fitting.types import Bools, Floats, Ints

_SILENT = 1e-7
"""A taxel with less than this share of the force at a place is not looked up there."""


@dataclass(frozen=True)
class TableReach:
    """Extent and steps of a table.

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

    def tables(self) -> Tables:
        """Return the table as the likelihood looks it up."""
        turns, levels = turns_of(self.reach), levels_of(self.reach)
        images = ImageTable(
            self.shares, self.lit, self.plane, self.anchor_m, self.log_ratio, self.slot, self.centre,
            turns, _spline(turns), levels, _spline(levels), self.reach.step_m,
        )  # fmt: skip
        return Tables(NO_KERNELS, images)

    def holds(self, macro: Floats) -> bool:
        """Return whether macro variables (5,) lie well within the table; the ratio F/E is left to its wide margin."""
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


def turns_of(reach: TableReach) -> Floats:
    """Tabled turns, from the middle one [rad]."""
    return np.linspace(-reach.alpha_rad, reach.alpha_rad, 3)


def levels_of(reach: TableReach) -> Floats:
    """Tabled log(F/E), from the middle one."""
    return np.linspace(-reach.log_ratio, reach.log_ratio, reach.levels)


def lit_nodes(shares: Floats) -> Bools:
    """Nodes (P, N, N) within reach of whose taps anything is not zero."""
    from scipy.ndimage import maximum_filter  # takes a moment, and few fits have such tables

    return maximum_filter(np.abs(shares[..., :-2]).max(axis=-1), size=(1, 5, 5)) > _SILENT


def smoothed(shares: Floats, variance: Floats) -> Floats:
    """Shares (P, N, N, C) smoothed over the place on the patch.

    By the discrete Gaussian (Lindeberg 1990), whose variance is right however narrow it is against the lattice.

    Args:
        shares: on the lattice.
        variance: (2,) along u and v, in squared lattice steps.
    """
    from scipy.ndimage import convolve1d

    for axis, square in enumerate(variance, start=1):
        if square <= 0:
            continue
        far = int(np.ceil(4 * square**0.5 + 2))
        kernel = np.asarray(ive(np.abs(np.arange(-far, far + 1)), square), dtype=np.float32)
        shares = np.asarray(convolve1d(shares, kernel / kernel.sum(), axis=axis, mode="nearest"))
    return shares


def _spline(knots: Floats) -> Floats:
    """Coefficients (4, K - 1, K) of the cubic splines (three knots: parabolas) that are 1 at one knot each."""
    return np.ascontiguousarray(CubicSpline(knots, np.eye(len(knots))).c)
