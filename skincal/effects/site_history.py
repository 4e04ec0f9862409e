"""The contact history of a site."""

from __future__ import annotations

import numpy as np

from skincal.model.arrays import FloatArray, IntArray


def met_before(site: IntArray, cycle: FloatArray, force_n: FloatArray) -> FloatArray:
    """Return the largest force of earlier touches of the same site (P,) [N], zero at its first one.

    For a site whose earlier touches are not among the presses, it is the median of the other sites' values. It is NaN
    where the number of touches is unknown, and for all repeats if no press has an earlier touch in the data.

    Args:
        site: (P,) site of each press, presses in the order of time.
        cycle: (P,) earlier touches of the site; equal in presses of one touch, such as plateaus of a staircase; NaN if
            unknown.
        force_n: (P,) force of each press [N].
    """
    met = np.where(cycle == 0, 0.0, np.nan)
    for k in np.flatnonzero(cycle > 0):
        before = (site[:k] == site[k]) & (cycle[:k] < cycle[k]) & np.isfinite(force_n[:k])
        met[k] = force_n[:k][before].max() if before.any() else np.nan
    again = cycle > 0
    told = met[again & np.isfinite(met)]
    return np.where(again & np.isnan(met), np.median(told) if len(told) else np.nan, met)
