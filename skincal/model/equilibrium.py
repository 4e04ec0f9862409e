"""The force equilibrium by itself: how deep an indenter goes in (paper, equation 5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, check_shape
from skincal.model.press.call import routine


def solve_penetration(gap_m: ArrayLike, weight_m2: ArrayLike, force_over_elasticity: ArrayLike) -> FloatArray:
    """Return the penetration at which the stresses carry the force: sum_i w_i max(p - g_i, 0) = F / E.

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
    load = np.array(force_over_elasticity, dtype=np.float64)
    gap = np.array(gap_m, dtype=np.float64)
    check_shape("force_over_elasticity", load, (None,))
    check_shape("gap_m", gap, (len(load), None))
    weight = np.array(np.broadcast_to(np.asarray(weight_m2, dtype=np.float64), gap.shape))
    met = (weight > 0) & (gap < np.inf)
    first = np.where(met, gap, np.inf).min(axis=1, initial=np.inf)
    first[first == np.inf] = 0.0
    gap, weight = np.where(met, gap - first[:, None], np.inf), np.where(met, weight, 0.0)
    depth = np.zeros(len(load))
    pressed = np.isfinite(load) & (load > 0) & met.any(axis=1)
    for k in np.flatnonzero(pressed):
        some = met[k]
        depth[k] = routine().depth(gap[k, some], weight[k, some], int(some.sum()), load[k], 0.0)
    return np.where(np.isfinite(load), first + depth, np.nan)
