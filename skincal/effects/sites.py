"""What the site of a press has met before."""

from __future__ import annotations

import numpy as np

from skincal.model.arrays import FloatArray, as_floats


def met_before(cycle: FloatArray, force_n: FloatArray, places_m: FloatArray) -> FloatArray:
    """The largest force of earlier presses of the same site (P,) [N], zero at its first touch.

    The press before one of a site is the nearest of those that count one touch less and that no other press has gone on
    from; it is NaN where there is none, or where the count of touches is not known.

    Args:
        cycle: (P,) earlier touches of the site of each press, presses in the order of time; NaN where not known.
        force_n: (P,) of each press [N].
        places_m: (P, 3) where each is [m].
    """
    met = np.where(cycle == 0, 0.0, np.nan)
    gone_on = np.zeros(len(cycle), dtype=np.bool_)
    for k in np.flatnonzero(cycle > 0):
        before = np.flatnonzero((cycle[:k] == cycle[k] - 1) & ~gone_on[:k])
        away = np.linalg.norm(places_m[before] - places_m[k], axis=1)
        if np.isfinite(away).any():
            last = before[np.nanargmin(away)]
            gone_on[last] = True
            met[k] = np.fmax(met[last], force_n[last])
    return as_floats(met)
