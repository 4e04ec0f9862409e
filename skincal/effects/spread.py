"""A cover spreads the pressure sideways before it reaches the taxels.

    p_felt(u, v) = integral of p(u', v') N(u - u', v - v'; w²)

over the patch's own coordinates. What a taxel feels is the integral of that over its area, so a tactile point at
(u, v) counts with the part of its Gaussian that lies on the taxel: a product of two differences of error functions.
The force as a whole stays what it is.
"""

from __future__ import annotations

import numpy as np
from scipy.special import erf

from skincal.effects.base import SpreadEffect
from skincal.effects.parameter import EffectParameter, Values
from skincal.errors import InputError, Problem
from skincal.model import Patch
from skincal.model.arrays import FloatArray


class Spread(SpreadEffect):
    """See the module."""

    name = "spread"
    meaning = "a cover spreads the pressure sideways before it reaches the taxels"
    parameters = (
        EffectParameter("width_m", "m", 0.0, 0.0, 6e-3, "standard deviation of the Gaussian", typical=0.9e-3),
    )
    source = (
        "Elastic covers as blurring filters: Phillips, Johnson, J. Neurophysiol. 46 (1981) 1204; "
        "Shimojo, IEEE Trans. Robot. Autom. 13 (1997) 128."
    )

    def weights(self, values: Values, patch: Patch) -> FloatArray:
        """See :meth:`SpreadEffect.weights`.

        Raises:
            InputError: a patch that does not know where its points lie on it.
        """
        if patch.uv_m is None:
            raise InputError([Problem("effect spread", "a patch cut from a surface", "one without uv_m")])
        width = values.number("width_m") * np.sqrt(2)
        low = patch.layout.centres_m - patch.layout.sizes_m / 2
        high = patch.layout.centres_m + patch.layout.sizes_m / 2
        return _part(patch.uv_m, low, high, width, 0) * _part(patch.uv_m, low, high, width, 1)


def _part(uv: FloatArray, low: FloatArray, high: FloatArray, width: float, axis: int) -> FloatArray:
    """How much of a Gaussian about each point (N, 2) lies between each pair of edges (J, 2), along one axis: (N, J)."""
    place = uv[:, axis, None]
    upper, lower = (
        np.asarray(erf((edge[:, axis] - place) / width), dtype=np.float64) for edge in (high, low)
    )
    return (upper - lower) / 2
