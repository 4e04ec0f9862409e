"""The force equilibrium: how deep an indenter goes in (paper, equation 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, check_shape


def solve_penetration(gap_m: ArrayLike, weight_m2: ArrayLike, force_over_elasticity: ArrayLike) -> FloatArray:
    """The penetration at which the stresses carry the force: sum_i w_i max(p - g_i, 0) = F / E.

    This is the paper's equation 5, with eps_i = max(eps_max - (d_i - delta), 0) (equation 7) and
    w_i = a_i max(n_t,i . n_c, 0).
    Any constant may be added to a press's gaps (as from d_i - delta to d_i): it is added to the result, and the
    local penetrations stay what they are.

    Args:
        gap_m: (K, N) gap of every point at first touch [m]; inf where the indenter cannot touch.
        weight_m2: (K, N) or (N,) projected areas [m²], zero for points that face away.
        force_over_elasticity: (K,) force over elasticity F / E [m³].

    Returns:
        (K,) penetration [m]. A force of zero or less gives the smallest gap (first touch: no point is
        penetrated); NaN or infinity gives NaN. Where no point can be touched it is 0, and no point is penetrated.

    Raises:
        ValueError: shapes that do not fit.
    """
    load = np.asarray(force_over_elasticity, dtype=np.float64)
    gap = np.asarray(gap_m, dtype=np.float64)
    check_shape("force_over_elasticity", load, (None,))
    check_shape("gap_m", gap, (len(load), None))
    weight = np.broadcast_to(np.asarray(weight_m2, dtype=np.float64), gap.shape)
    known = np.isfinite(load)
    settled = settle(gap, weight, np.where(known, np.maximum(load, 0.0), 0.0))
    first = np.where(np.isfinite(settled.first_m), settled.first_m, 0.0)
    return np.where(known, first + settled.depth_m, np.nan)


@dataclass(frozen=True, eq=False)
class Settled:
    """Presses in equilibrium.

    Attributes:
        first_m: (K,) the smallest distance [m]; inf where no point can be touched.
        depth_m: (K,) how far the equilibrium lies beyond it [m]; 0 where there is no load or nothing to carry it.
        gap_m: (K, N) distances beyond the smallest [m]; 0 where a point cannot be touched.
        weight_m2: (K, N) as given; 0 where a point cannot be touched.
    """

    first_m: FloatArray
    depth_m: FloatArray
    gap_m: FloatArray
    weight_m2: FloatArray


def settle(
    distance_m: FloatArray, weight_m2: FloatArray, load_m3: FloatArray, near_m: FloatArray | None = None
) -> Settled:
    """The depth at which the load is carried.

    The carried load is convex and piecewise linear in the depth, with a kink at every gap. Newton's method takes one
    linear piece after the other: from anywhere its first step leads to the solution or above it, from there on it never
    goes below, drops at least one point in every step, and ends where the set of points that carry no longer changes.
    There the depth is exact.

    Args:
        distance_m: (K, N) [m]; inf or NaN where a point cannot be touched.
        weight_m2: (K, N) [m²]; a point without weight cannot be touched either.
        load_m3: (K,) F / E [m³], finite, zero or more.
        near_m: (K,) levels that the solution is thought to lie near, inf where nothing is thought [m]. It saves steps
            and changes nothing else.
    """
    out = ~((weight_m2 > 0) & (distance_m < np.inf))
    first = np.where(out, np.inf, distance_m).min(axis=1, initial=np.inf)
    begin = np.where(first < np.inf, first, 0.0)
    gap = distance_m - begin[:, None]
    gap[out] = 0.0
    weight = np.where(out, 0.0, weight_m2)
    pressed = (first < np.inf) & (load_m3 > 0)
    near = np.full(len(load_m3), np.inf) if near_m is None else np.maximum(near_m - begin, 0.0)
    if pressed.all():
        return Settled(first, _depth(gap, weight, load_m3, near), gap, weight)
    depth = np.zeros(len(load_m3))
    if pressed.any():
        depth[pressed] = _depth(gap[pressed], weight[pressed], load_m3[pressed], near[pressed])
    return Settled(first, depth, gap, weight)


def _depth(gap: FloatArray, weight: FloatArray, load: FloatArray, near: FloatArray) -> FloatArray:
    """The depth (K,) > 0 with sum_i w_i max(depth - g_i, 0) = load > 0; the smallest gap is 0."""
    moment = weight * gap
    depth = _level(gap, weight, moment, load, near)
    while True:
        lower = _level(gap, weight, moment, load, depth)
        if not (lower < depth).any():
            return depth
        depth = np.minimum(lower, depth)


def _level(
    gap: FloatArray, weight: FloatArray, moment: FloatArray, load: FloatArray, depth: FloatArray
) -> FloatArray:
    """The depth (K,) at which the points that carry at another depth would carry the load, they and no others."""
    carries = (gap <= depth[:, None]).astype(np.float64)
    area = np.einsum("kn,kn->k", carries, weight)
    return (load + np.einsum("kn,kn->k", carries, moment)) / area
