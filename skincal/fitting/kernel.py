"""Load kernels: the response of a taxel to a contact by its offset, tabled once, so that an image is a table look-up.

On a surface that looks the same everywhere (a cylinder, a plane), the pressure under an indenter is one field
that moves with the contact, and stress and force both scale with E, so that

    T_j = S_j F_n phi(u_c - u_j, v_c - v_j; alpha, F_n / E).

phi is the share of the normal force that the taxel reports: the integral of the field over its rectangle, with
both projection factors and the force equilibrium of :mod:`skincal.model`.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.fitting.lookup import KernelTable, allocating, inlined
from skincal.fitting.types import Floats
from skincal.model import Contacts, Indenter, SensorPose, Surface, TaxelLayout

MAX_NODES = 640
"""Most nodes along one side of a table; a larger contact is tabled on a coarser lattice."""

STEP_M = 0.1e-3
"""Lattice step of tables, unless the contact is so large that it would need too many nodes [m]."""

RATIO_STEP = 0.05
"""Spacing of the tabled logs of F/E. Linear interpolation between them is accurate to 3e-4 of a load share."""


@dataclass(frozen=True, eq=False)
class _Field:
    """Gap and projected areas of the surface around a contact, per cell (N, N)."""

    gap_m: Floats
    force_area_m2: Floats
    load_area_m2: Floats


def build_table(
    surface: Surface,
    indenters: tuple[Indenter, ...],
    layout: TaxelLayout,
    alphas_rad: Floats,
    ratio_span: tuple[float, float],
    *,
    spread_m: float = 0.0,
    projected: bool = True,
) -> KernelTable:
    """Table the load shares of taxels.

    Args:
        surface: a cylinder or a plane.
        indenters: the different indenters of the presses.
        layout: the taxels.
        alphas_rad: (A,) equally spaced turns [rad]. Shares are interpolated linearly between them: the turn
            acts mostly through u and v, and what remains is the turn of a nearly round field.
        ratio_span: lowest and highest log(F_n / E) needed; F_n / E in [m³].
        spread_m: width of the Gaussian that spreads the pressure sideways [m]; 0 for the paper's foundation.
        projected: whether a taxel feels the pressure times both projections of the paper; else the pressure
            itself.
    """
    levels = max(2, int(np.ceil((ratio_span[1] - ratio_span[0]) / RATIO_STEP)) + 1)
    log_ratios = ratio_span[0] + RATIO_STEP * np.arange(levels)
    sizes, size_of = np.unique(np.round(layout.sizes_m, 9), axis=0, return_inverse=True)
    ratios = np.exp(log_ratios)
    reach = max(contact_reach(surface, one, float(ratios[-1])) for one in indenters) + 3 * spread_m
    half = reach + float(np.max(sizes)) / 2
    step = max(STEP_M, 2 * half / (MAX_NODES - 8))
    count = int(np.ceil(half / step)) + 2
    side = 2 * count + 1
    shares = np.zeros((len(indenters), len(sizes), len(alphas_rad), levels, side, side), dtype=np.float32)
    blur = gaussian_blur(side, spread_m / step)
    for i, indenter in enumerate(indenters):
        for a, alpha in enumerate(alphas_rad):
            field = _build_field(surface, indenter, float(alpha), count, step)
            area = field.load_area_m2 if projected else step**2
            for level, depth in enumerate(_solve_penetrations(field, ratios)):
                load = np.maximum(depth - field.gap_m, 0.0) * area
                if spread_m > 0:
                    u, v = load.any(axis=1), load.any(axis=0)
                    load = blur[:, u] @ load[np.ix_(u, v)] @ blur[v]
                for m, (du, dv) in enumerate(sizes):
                    box_shares(load, du / step, dv / step, 1.0 / ratios[level], shares[i, m, a, level])
    # The border is zero, so that an offset clamped to it reads zero.
    shares[..., [0, 1, -2, -1], :] = 0.0
    shares[..., [0, 1, -2, -1]] = 0.0
    turns, spacing = (
        (float(knots[0]), float(knots[1] - knots[0]) if len(knots) > 1 else 1.0)
        for knots in (alphas_rad, log_ratios)
    )
    return KernelTable(
        shares,
        size_of.reshape(-1),
        layout.centres_m,
        turns,
        spacing,
        step,
        count * step,
        _measure_reach(shares) * step,
    )


def _measure_reach(shares: NDArray[np.float32]) -> Floats:
    """Return the offset (I, L) in lattice steps from which look-ups of ``shares`` are zero, at a ratio and the next."""
    side = shares.shape[-1]
    off: Floats = np.abs(np.arange(side, dtype=np.float64) - side // 2)
    along = np.logical_or(shares.any(axis=(1, 2, 4)), shares.any(axis=(1, 2, 5)))
    # A look-up uses two nodes on either side, and a spread pressure ends with the table.
    reach = np.minimum((along * (off + 2)).max(axis=2), side // 2 - 1.5)
    reach[:, :-1] = np.maximum(reach[:, :-1], reach[:, 1:])
    return reach


def _build_field(surface: Surface, indenter: Indenter, alpha_rad: float, count: int, step_m: float) -> _Field:
    """Return the surface around a contact, on a lattice in patch coordinates centred on the contact."""
    axis = np.arange(-count, count + 1) * step_m
    # The share is a function of contact minus taxel, so the field is laid out mirrored, at minus the
    # offset.
    u, v = np.meshgrid(-axis, -axis, indexing="ij")
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    points, normals = surface.wrap(SensorPose(0.0, alpha_rad), uv)
    at, out = surface.wrap(SensorPose(0.0, alpha_rad), np.zeros((1, 2)))
    rotation = Contacts(at, out, np.ones(1)).indenter_rotations[0]
    hits = indenter.cast((points - at) @ rotation, np.array([0.0, 0.0, 1.0]))
    facing = np.nan_to_num(np.maximum(normals @ out[0], 0.0))
    distance = np.where(facing > 0, hits.distance_m, np.inf)
    shape = (2 * count + 1, 2 * count + 1)
    force_area = facing * step_m**2
    return _Field(
        (distance - distance.min()).reshape(shape),
        force_area.reshape(shape),
        (force_area * np.where(facing > 0, hits.facing, 0.0)).reshape(shape),
    )


def _solve_penetrations(field: _Field, ratios_m3: Floats) -> Floats:
    """Return the penetrations [m] that balance F_n / E = sum_i eps_i a_i (n_t . n_c).

    The sum is piecewise linear in the penetration, so the solution is exact.
    """
    inside = np.isfinite(field.gap_m) & (field.force_area_m2 > 0)
    order = np.argsort(field.gap_m[inside], kind="stable")
    gaps = field.gap_m[inside][order]
    areas = np.cumsum(field.force_area_m2[inside][order])
    moments = np.cumsum(field.force_area_m2[inside][order] * gaps)
    held = gaps * areas - moments
    inner = np.interp(ratios_m3, held, gaps)
    beyond = (ratios_m3 + moments[-1]) / areas[-1]
    return np.where(ratios_m3 > held[-1], beyond, inner)


def contact_reach(surface: Surface, indenter: Indenter, ratio_m3: float) -> float:
    """Return the radius around the contact that contains all of it [m], on a cylinder or a plane, at F_n / E [m³]."""
    asked, count, half = pickle.dumps((surface, indenter)), 40, 1e-3
    for _ in range(14):
        field = _cached_field(asked, count, half)
        touched = field.gap_m < _solve_penetrations(field, np.array([ratio_m3]))[0]
        u, v = np.nonzero(touched)
        radius = float(np.hypot(u - count, v - count).max()) + 1.0
        if radius < 0.9 * count:
            return half * radius / count
        half *= 1.5
    return half


@lru_cache(maxsize=64)
def _cached_field(asked: bytes, count: int, half_m: float) -> _Field:
    """Return the field of a surface and an indenter at turn 0.

    The key is pickled content, because every task brings its own copy of the objects.
    """
    surface, indenter = pickle.loads(asked)
    return _build_field(surface, indenter, 0.0, count, half_m / count)


def gaussian_blur(side: int, sigma: float) -> Floats:
    """Return a matrix (N, N) that blurs one axis of a field by ``sigma`` cells, truncated at four sigmas."""
    if sigma <= 0:
        return np.eye(side)
    reach = int(4.0 * sigma + 0.5)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    off = np.abs(np.subtract.outer(np.arange(side), np.arange(side)))
    return np.where(off <= reach, np.exp(-0.5 * (off / sigma) ** 2), 0.0) / weight.sum()


@inlined
def _box_edges(width: float, low: Any, part: Any) -> None:  # pragma: no cover - compiled
    """Fill cells (2, N), and fractions of them, where a box of ``width`` cells around each cell starts and ends."""
    side = low.shape[1]
    for i in range(side):
        for end in range(2):
            at = min(max(i + 0.5 + (end - 0.5) * width, 0.0), float(side))
            low[end, i] = min(int(at), side - 1)
            part[end, i] = at - low[end, i]


@allocating
def box_shares(
    load: Any, width_u: float, width_v: float, factor: float, out: Any
) -> None:  # pragma: no cover - compiled
    """Fill ``out`` (N, N) with integrals of a cell-wise constant field over a box centred on each cell, times a factor.

    The widths of the box along both axes are in cells.
    """
    side = load.shape[0]
    total, line = np.zeros((side + 1, side)), np.zeros(side + 1)
    for r in range(side):
        for c in range(side):
            total[r + 1, c] = total[r, c] + load[r, c]
    low, part = np.empty((2, side), dtype=np.int64), np.empty((2, side))
    first, rest = np.empty((2, side), dtype=np.int64), np.empty((2, side))
    _box_edges(width_u, low, part)
    _box_edges(width_v, first, rest)
    for r in range(side):
        above, below = total[low[1, r]], total[low[0, r]]
        past, before = total[low[1, r] + 1], total[low[0, r] + 1]
        p, q = part[1, r], part[0, r]
        for c in range(side):
            along = above[c] + p * (past[c] - above[c]) - below[c] - q * (before[c] - below[c])
            line[c + 1] = line[c] + along
        for c in range(side):
            j, i = first[1, c], first[0, c]
            end = line[j] + rest[1, c] * (line[j + 1] - line[j])
            out[r, c] = factor * (end - line[i] - rest[0, c] * (line[i + 1] - line[i]))
