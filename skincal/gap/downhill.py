"""Presses that a step leads over their valley, and how the next one is damped for them alone (Marquardt 1963)."""

from __future__ import annotations

import numpy as np

from skincal.model.arrays import BoolArray, FloatArray

DAMPING = 0.3
"""Of places, by how much their own curvature is made larger: while much else is wrong they should not jump."""
_MORE = 4.0
_UPHILL, _UPHILL_SHARE = 0.5, 1e-3
"""A press that costs more by less than this, absolute and relative, is taken to cost the same, as rounding does that
much."""


def uphill(costs: FloatArray, after: FloatArray) -> BoolArray:
    """Presses (P,) that a step made cost more than rounding does, or left without an image that had one.

    Args:
        costs: (P,) before it; NaN where a press lies beyond the rim of a mesh and has no image.
        after: (P,) after it.
    """
    return ~(after <= costs + _UPHILL + _UPHILL_SHARE * costs) & np.isfinite(costs)


def damped(damping: FloatArray, wrong: BoolArray) -> FloatArray:
    """The damping (P,) of the next step: more for presses that the last one led uphill, none for others."""
    return np.where(wrong, np.maximum(_MORE * damping, 1.0), 0.0)
