"""Parts of a Gaussian about each tactile point that lie on each taxel."""

from __future__ import annotations

import numpy as np

from skincal.model.arrays import FloatArray, IntArray
from skincal.model.layout import TaxelLayout
from skincal.model.patch import Patch

_WIDTH_M = 3e-4
"""Width of the Gaussian that a small variance is a part of [m]: about as wide as a cell, so that points resolve it."""


def little_spread(patch: Patch, variance_m2: float) -> FloatArray:
    """Return weights (N, J) of points in taxels, spread by a small variance along each axis, to first order in it.

    A negative variance sharpens.

    Raises:
        ValueError: the patch lacks the coordinates of its points.
    """
    if patch.uv_m is None:
        raise ValueError("spreading: expected a patch cut from a surface; got one without uv_m")
    own = np.zeros((len(patch), patch.layout.taxels))
    felt = patch.taxel >= 0
    own[felt, patch.taxel[felt]] = 1.0
    widths = np.array([np.sqrt(2.0) * _WIDTH_M])
    (across, column), (along, row) = (gaussian_parts(patch.uv_m, patch.layout, widths, k) for k in (0, 1))
    return own + variance_m2 / _WIDTH_M**2 * (across[0][column] * along[0][row] - own)


def gaussian_parts(
    uv: FloatArray, layout: TaxelLayout, widths: FloatArray, axis: int
) -> tuple[FloatArray, IntArray]:
    """Return the parts of Gaussians about points (N, 2) that lie on taxels, along one axis.

    Args:
        uv: points of a patch in its coordinates [m].
        layout: the taxels.
        widths: (m,) root of twice the variance of each Gaussian [m].
        axis: 0 across, 1 along.

    Points of a patch lie in rows and columns; error functions are computed once for each of these.

    Returns:
        The parts (m, n, J) at n places for m widths, and the place (N,) of each point.
    """
    from scipy.special import erf  # takes a moment, and few skins have a cover

    places, which = np.unique(uv[:, axis], return_inverse=True)
    half = layout.sizes_m[:, axis] / 2
    lower, upper = (
        np.asarray(
            erf((layout.centres_m[:, axis] + side * half - places[:, None]) / widths[:, None, None]),
            dtype=np.float64,
        )
        for side in (-1, 1)
    )
    return (upper - lower) / 2, np.asarray(which, dtype=np.int64)
