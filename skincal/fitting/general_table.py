"""Images of the skin model, tabled press by press around one pose of the sensor.

The skin model is too slow for a million evaluations, and its images are not smooth enough to differentiate. It
is evaluated once around a pose: for every press its load shares on a lattice of positions on the patch (u, v), a
few turns alpha and a few ratios F/E. A shift of the sensor's centre adds a first-order term, found by finite
differences, where the surface does not look the same everywhere:

    phi(u, v; centre) = phi(u, v; centre_0) + (centre - centre_0) . d phi / d centre |_(u, v)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256

import numpy as np
from scipy.special import ive

from skincal.fitting.general_skin import RESOLUTION_M, SkinShares
from skincal.fitting.lattice import square
from skincal.fitting.lookup import NO_KERNELS, ImageTable, Tables
from skincal.fitting.posterior import Peak
from skincal.fitting.presses import from_patch, to_patch
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Bools, Floats, Ints

PART = 6
"""Presses tabled in one task."""

_CENTRE_STEP_M = 1e-3
"""Step of the finite difference by the centre [m]: longer than the facets of a mesh, so that single edges do not
matter."""

_LOADED = 1e-6
"""A taxel of a press is tabled if it ever gets this share of the force."""

_SILENT = 1e-7
"""A taxel is looked up at a position only if it gets this share of the force there."""


@dataclass(frozen=True)
class TableReach:
    """Extent and steps of a table.

    Attributes:
        centre_m: largest shift of the sensor's centre from the tabled one [m].
        alpha_rad: largest change of the turn [rad].
        log_ratio: largest change of log(F/E).
        levels: number of tabled ratios.
        step_m: lattice step on the patch [m].
        resolution_m: cell size of the patch [m].
    """

    centre_m: float
    alpha_rad: float
    log_ratio: float
    levels: int = 7
    step_m: float = 0.3e-3
    resolution_m: float = RESOLUTION_M

    @property
    def tabled_turns(self) -> Floats:
        """(3,) tabled turns, relative to the middle one [rad]."""
        return np.linspace(-self.alpha_rad, self.alpha_rad, 3)

    @property
    def tabled_ratios(self) -> Floats:
        """(L,) tabled log(F/E), relative to the middle one."""
        return np.linspace(-self.log_ratio, self.log_ratio, self.levels)


ROUGH = TableReach(1.2e-3, np.radians(8.0), 0.9, levels=5, step_m=0.5e-3, resolution_m=0.5e-3)
"""Reach of the table for a climb from a grid point."""


@dataclass(frozen=True, eq=False)
class SkinTable:
    """Tabled images of K presses.

    Attributes:
        shares: (P, N, N, A * L + 2) float32: share of the force that a taxel reports, for turns and ratios,
            and its derivative by the centre across and along [1/m]; for those taxels of presses that are ever
            loaded.
        lit: (P, N, N) nodes where a look-up may not be zero.
        plane: (K, J) which of the P planes belongs to a taxel of a press, or -1.
        anchor_m: (K, 2) patch coordinates of the middle of each press's lattice [m].
        slot: (M,) for every press of the session its row here, or -1.
        log_ratio: (K,) log(F/E) in the middle of the tabled ratios.
        centre: (3,) tabled centre across and along [m], and turn [rad].
        reach: extent of the table.
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
        """Return the table in the form of the compiled look-up."""
        turns, levels = self.reach.tabled_turns, self.reach.tabled_ratios
        images = ImageTable(
            self.shares, self.lit, self.plane, self.anchor_m, self.log_ratio, self.slot, self.centre,
            turns, _spline(turns), levels, _spline(levels), self.reach.step_m,
        )  # fmt: skip
        return Tables(NO_KERNELS, images)

    def holds(self, macro: Floats) -> bool:
        """Return whether macro variables (5,) lie well within the table; F/E is not checked, as its margin is wide."""
        away = np.abs(macro[:3] - self.centre)
        reach = np.array([self.reach.centre_m, self.reach.centre_m, self.reach.alpha_rad])
        return bool((away <= 0.8 * reach).all())

    def spread(self, width_m: float) -> SkinTable:
        """Return the table of a skin that spreads the pressure sideways by a Gaussian [m].

        Pressure that spreads by d loads a taxel as if the contact lay d further away, so the shares are
        smoothed over the position on the patch.
        """
        if width_m <= 0:
            return self
        variance = np.full(2, (width_m / self.reach.step_m) ** 2)
        shares = smooth_shares(self.shares, variance)
        return replace(self, shares=shares, lit=find_lit_nodes(shares))


def find_lit_nodes(shares: Floats) -> Bools:
    """Return the nodes (P, N, N) whose look-up neighbourhood is not zero everywhere."""
    from scipy.ndimage import maximum_filter  # slow to import, and few fits have such tables

    return maximum_filter(np.abs(shares[..., :-2]).max(axis=-1), size=(1, 5, 5)) > _SILENT


def smooth_shares(shares: Floats, variance: Floats) -> Floats:
    """Return shares (P, N, N, C) smoothed over the position on the patch.

    The kernel is the discrete Gaussian (Lindeberg 1990), whose variance is exact even if it is narrow
    compared with the lattice. ``variance`` (2,) along u and v is in squared lattice steps.
    """
    from scipy.ndimage import convolve1d

    for axis, width in enumerate(variance, start=1):
        if width <= 0:
            continue
        far = int(np.ceil(4 * width**0.5 + 2))
        kernel = np.asarray(ive(np.abs(np.arange(-far, far + 1)), width), dtype=np.float32)
        shares = np.asarray(convolve1d(shares, kernel / kernel.sum(), axis=axis, mode="nearest"))
    return shares


def _spline(knots: Floats) -> Floats:
    """Return coefficients (4, K - 1, K) of the cubic splines (three knots: parabolas) that are 1 at one knot each."""
    from scipy.interpolate import CubicSpline  # slow to import, and few fits have such tables

    return np.ascontiguousarray(CubicSpline(knots, np.eye(len(knots))).c)


def split_presses(problem: FitProblem) -> list[Ints]:
    """Split the presses of a table into tasks; return the numbers of the presses of each."""
    return np.array_split(np.arange(len(problem)), -(-len(problem) // PART))


def make_table_key(problem: FitProblem, presses: Ints, macro: Floats, reach: TableReach) -> str:
    """Return a hash of what a table of one problem depends on: its presses, its middle and its reach."""
    steps = np.array(list(asdict(reach).values()), dtype=np.float64)
    depends = (problem.rows, presses, macro[:4], steps)
    return sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in depends)).hexdigest()[:24]


def choose_reach(peak: Peak) -> TableReach:
    """Return the reach of a fine table that covers four standard deviations around a peak."""
    sigma = np.sqrt(np.maximum(np.diag(peak.covariance), 0.0))
    return TableReach(
        centre_m=float(np.clip(4 * sigma[:2].max(), 0.2e-3, 1.0e-3)),
        alpha_rad=float(np.clip(4 * sigma[2], np.radians(1.5), np.radians(6.0))),
        # Wide enough for the E of other contact laws.
        log_ratio=float(np.clip(4 * sigma[3], 0.6, 0.9)),
    )


def join_tables(parts: Sequence[SkinTable]) -> SkinTable:
    """Join tables of some presses into one table of all."""
    planes = np.cumsum([0, *(len(part.shares) for part in parts)])
    presses = np.cumsum([0, *(len(part.plane) for part in parts)])
    stacked = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("shares", "lit", "anchor_m", "log_ratio")
    }
    plane = [np.where(p.plane >= 0, p.plane + n, -1) for p, n in zip(parts, planes, strict=False)]
    slot = [np.where(p.slot >= 0, p.slot + n, -1) for p, n in zip(parts, presses, strict=False)]
    return replace(parts[0], **stacked, plane=np.concatenate(plane), slot=np.max(slot, axis=0))


def tabulate_presses(problem: FitProblem, presses: Ints, macro: Floats, reach: TableReach) -> SkinTable:
    """Table presses (K,), by their numbers, on a lattice of positions on the patch, around macro variables (5,)."""
    measured = np.stack([problem.across_m, problem.along_m], axis=1)
    off = measured - macro[:2]
    anchor = to_patch(off[:, 0], off[:, 1], np.full(len(problem), macro[2]))
    # A turn moves the positions of a press on the patch; use the largest shift for all presses, so that
    # their tables can be joined.
    swept = reach.alpha_rad * float(np.hypot(*anchor.T).max())
    # Two more nodes on every side, so that a look-up at the edge has all its neighbours.
    count = int(np.ceil((problem.rig.slack_m + reach.centre_m + swept) / reach.step_m)) + 2
    axis = np.arange(-count, count + 1) * reach.step_m
    lattice = square(axis)
    uv = (anchor[presses, None] + lattice).reshape(-1, 2)
    press = np.repeat(presses, len(lattice))
    middle = np.log(problem.force_n) - macro[3]

    def placed(shift: Floats) -> SkinShares:
        at = (float(x) for x in macro[:3] + shift)
        return SkinShares(problem, *at, resolution_m=reach.resolution_m)

    home = placed(np.zeros(3))

    def images(shift: Floats, levels: Floats) -> list[Floats]:
        """Shares (n, J) at every level, with the sensor's centre and turn shifted (3,)."""
        skin = placed(shift)
        if skin.skin is None:  # the taxels would not fit on the surface there: assume no change of the image
            skin, shift = home, np.zeros(3)
        at = macro[:3] + shift
        slack = from_patch(uv, np.full(len(uv), at[2])) + at[:2] - measured[press]
        return [skin.shares(press, slack, middle[press] + v).astype(np.float32) for v in levels]

    channels: list[Floats] = []
    for turn in reach.tabled_turns:
        channels += images(np.array([0.0, 0.0, turn]), reach.tabled_ratios)
    for shift in _CENTRE_STEP_M * np.eye(2, 3):
        ahead, behind = (images(s, np.zeros(1))[0] for s in (shift, -shift))
        channels.append((ahead - behind) / (2 * _CENTRE_STEP_M))
    stacked = np.stack(channels, axis=-1).reshape(len(presses), len(axis), len(axis), -1, len(channels))
    stacked = np.moveaxis(stacked, 3, 1)
    loaded = stacked[..., :-2].max(axis=(2, 3, 4)) > _LOADED
    plane = np.full(loaded.shape, -1, dtype=np.intp)
    plane[loaded] = np.arange(loaded.sum())
    slot = np.full(len(problem.status), -1, dtype=np.intp)
    slot[problem.rows[presses]] = np.arange(len(presses))
    shares = smooth_shares(np.ascontiguousarray(stacked[loaded]), home.lost_m2() / reach.step_m**2)
    return SkinTable(
        shares, find_lit_nodes(shares), plane, anchor[presses], slot, middle[presses], macro[:3], reach
    )
