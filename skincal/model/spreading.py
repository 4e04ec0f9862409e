"""Spreading of the load: the fraction of a Gaussian around each tactile point that lies on each taxel."""

from __future__ import annotations

import numpy as np

from skincal.model.arrays import FloatArray, IntArray
from skincal.model.layout import TaxelLayout
from skincal.model.patch import Patch

_WIDTH_M = 3e-4
"""Standard deviation of the Gaussian for the finite difference [m]: about a cell, so that the points resolve it."""


def spread_weights(patch: Patch, variance_m2: float) -> FloatArray:
    """Return weights (N, J) of points in taxels for a spreading of small variance, linearised in the variance.

    The weights are extrapolated from no spreading and one Gaussian of fixed width; a negative variance sharpens.

    Args:
        patch: the tactile points.
        variance_m2: variance along each axis [m²].

    Raises:
        ValueError: the patch lacks the coordinates of its points.
    """
    if patch.uv_m is None:
        raise ValueError("spreading: expected a patch cut from a surface; got one without uv_m")
    own = np.zeros((len(patch), patch.layout.taxels))
    sensed = patch.taxel >= 0
    own[sensed, patch.taxel[sensed]] = 1.0
    widths = np.array([np.sqrt(2.0) * _WIDTH_M])
    (across, column), (along, row) = (gaussian_parts(patch.uv_m, patch.layout, widths, k) for k in (0, 1))
    return own + variance_m2 / _WIDTH_M**2 * (across[0][column] * along[0][row] - own)


def gaussian_parts(
    uv: FloatArray, layout: TaxelLayout, widths: FloatArray, axis: int
) -> tuple[FloatArray, IntArray]:
    """Return the fractions of Gaussians around points that lie on taxels, along one axis.

    Points of a patch lie in rows and columns, so that the error functions are computed once per row or column.

    Args:
        uv: (N, 2) points in patch coordinates [m].
        layout: the taxels.
        widths: (m,) root of twice the variance of each Gaussian [m].
        axis: 0 across, 1 along.

    Returns:
        Fractions (m, n, J) for m widths at the n distinct coordinates, and the index (N,) of each point's coordinate.
    """
    from scipy.special import erf  # slow import, and few skins have a cover

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
