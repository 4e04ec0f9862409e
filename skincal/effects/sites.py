"""What the site of a press has met before."""

from __future__ import annotations

import numpy as np

from skincal.model.arrays import FloatArray, IntArray


def met_before(site: IntArray, cycle: FloatArray, force_n: FloatArray) -> FloatArray:
    """Return the largest force of earlier touches of the same site (P,) [N], zero at its first one.

    Of a site whose earlier touches are not among the presses, the middle of what others have met is taken. It is NaN
    where the count of touches is not known, and at all repeats where none has an earlier press.

    Args:
        site: (P,) number of the site of each press, presses in the order of time.
        cycle: (P,) earlier touches of it; alike in presses of one touch, as the plateaus of a staircase; NaN where not
            known.
        force_n: (P,) of each press [N].
    """
    met = np.where(cycle == 0, 0.0, np.nan)
    for k in np.flatnonzero(cycle > 0):
        before = (site[:k] == site[k]) & (cycle[:k] < cycle[k]) & np.isfinite(force_n[:k])
        met[k] = force_n[:k][before].max() if before.any() else np.nan
    again = cycle > 0
    told = met[again & np.isfinite(met)]
    return np.where(again & np.isnan(met), np.median(told) if len(told) else np.nan, met)
