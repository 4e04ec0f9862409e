"""Steps that lead downhill: within bounds, and damped for those presses alone that they lead over their valley.

The damping is that of Marquardt (1963), the bounds are an active set.
"""

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


def bounded_step(curve: FloatArray, pull: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """The step (n,) to where a quadratic is smallest, of those within bounds.

    A number that would leave its bounds goes as far as they are, and the others where it is best then. Were it clipped
    afterwards, they would go with what it does not do: uphill, as often as not.

    Args:
        curve: (n, n) second derivatives.
        pull: (n,) what pulls at each number, the first derivatives' opposite.
        low: (n,) lower bounds of the step, at most zero.
        high: (n,) upper ones, at least zero.
    """
    step, free = np.zeros(len(pull)), np.ones(len(pull), dtype=np.bool_)
    while free.any():
        rest = pull[free] - curve[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.solve(curve[np.ix_(free, free)], rest)
        out = free & ((step < low) | (step > high))
        if not out.any():
            break
        step[out] = np.clip(step, low, high)[out]
        free &= ~out
    return step
