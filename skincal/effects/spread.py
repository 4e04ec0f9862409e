"""A cover spreads the pressure sideways before it reaches the taxels.

    p_felt(u, v) = integral of p(u', v') K(u - u', v - v')

over the patch's own coordinates. K is a Gaussian of variance w² along each axis, or a mixture of concentric Gaussians
whose variances have a gamma distribution with mean w² and variance c w⁴. With c = 1 it is Pasternak's sheet,
q - (w²/2) laplace q = p, which has only shear stiffness and carries a load farther; with c = 0 it is the single
Gaussian. A taxel feels the integral of the pressure over its area, so that a tactile point at (u, v) counts with the
part of its kernel that lies on the taxel: products of two differences of error functions. The total force does not
change.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import SpreadEffect
from skincal.effects.parameter import Values, form, start, strength
from skincal.errors import input_error
from skincal.model import Patch
from skincal.model.arrays import FloatArray, as_floats
from skincal.model.skin import gaussian_parts

_NODES = 8
_LEAST_TAIL = 0.02
"""Tail below which the nodes of the quadrature merge; there the influence of the tail is taken as linear."""


class Spread(SpreadEffect):
    name = "spread"
    zero_error = 0.0
    errs_over = "place"
    meaning = "a cover spreads the pressure sideways before it reaches the taxels"
    parameters = (
        strength("width_m", "m", 0.0, 0.0, 6e-3, "standard deviation of the kernel", typical=0.9e-3),
        form("tail", "-", 0.0, 0.0, 1.0, "c: from a Gaussian (0) to Pasternak's sheet (1)"),
    )
    search_from = tuple(start({"width_m": 0.7e-3, "tail": c}) for c in (0.0, 1.0))
    shows = "places"
    source = (
        "Elastic covers as blurring filters: Phillips, Johnson, J. Neurophysiol. 46 (1981) 1204; "
        "Shimojo, IEEE Trans. Robot. Autom. 13 (1997) 128. The sheet: Kerr, J. Appl. Mech. 31 (1964) 491."
    )

    def weights(self, values: Values, patch: Patch) -> FloatArray:
        """Return the weights (:meth:`SpreadEffect.weights`).

        Raises:
            InputError: the patch lacks the coordinates of its points.
        """
        if patch.uv_m is None:
            raise input_error("effect spread", "a patch cut from a surface", "one without uv_m")
        variances, shares = _mixture(values.number("tail"))
        widths = values.number("width_m") * np.sqrt(2 * variances)
        (across, column), (along, row) = (gaussian_parts(patch.uv_m, patch.layout, widths, k) for k in (0, 1))
        found = np.zeros((len(patch.uv_m), across.shape[-1]))
        for one, other in zip(shares[:, None, None] * across, along, strict=True):
            found += one[column] * other[row]
        return found


def _mixture(tail: float) -> tuple[FloatArray, FloatArray]:
    """Return relative variances and weights of the Gaussians: quadrature nodes of a gamma distribution."""
    if tail <= 0:
        return np.ones(1), np.ones(1)
    from scipy.special import roots_genlaguerre  # takes a moment

    least = max(tail, _LEAST_TAIL)
    nodes, weights = roots_genlaguerre(_NODES, 1 / least - 1)
    part = tail / least
    return as_floats(np.append(nodes * least, 1.0)), as_floats(
        np.append(part * weights / weights.sum(), 1 - part)
    )
