"""The force equilibrium as scalar code: the penetration of an indenter (paper, equation 5)."""

from __future__ import annotations

import math

from skincal.model.arrays import FloatArray
from skincal.model.press.jit import device

_STEPS = 200
"""Largest number of Newton steps. Ten are usual: every step drops at least one point, early ones many."""
_LAW_STEPS = 60
"""Largest number of Newton steps for a power law; three to six are usual."""
_ENOUGH = 1e-12
"""Relative change of the depth in a step, below which the iteration has converged."""
_CLOSED = 1e-14
"""Relative width of a bracket that rounding prevents from shrinking further."""
Law = tuple[float, float, float]
"""E [Pa/m], exponent (1: linear) and reference penetration [m] of the stress law."""
NO_END = math.inf
"""Upper end of a bracket that has none yet."""


@device
def linear_depth(gap: FloatArray, weight: FloatArray, count: int, load: float, start: float) -> float:
    """Return the exact depth with sum_i w_i max(depth - g_i, 0) = load > 0.

    The carried load is convex and piecewise linear in the depth, with a kink at every gap. Newton's method visits one
    linear piece after the other. Its first step leads to the solution or above it; later steps never go below, drop at
    least one point each, and end when the set of carrying points no longer changes.

    Args:
        gap: (count,) distances beyond the smallest, one of them 0 [m].
        weight: (count,) areas along the contact normal, positive [m²].
        count: number of points, one or more.
        load: F / E [m³].
        start: initial guess of the depth, zero or more [m].
    """
    depth = start
    for step in range(_STEPS):
        area = 0.0
        moment = 0.0
        for i in range(count):
            carries = 1.0 if gap[i] <= depth else 0.0
            area += weight[i] * carries
            moment += weight[i] * gap[i] * carries
        lower = (load + moment) / area
        if step > 0 and not lower < depth:
            break
        depth = lower
    return depth


@device
def power_step(
    depth: float, low: float, high: float, total: float, slope: float, load: float, exponent: float
) -> tuple[float, float, float, bool]:
    """Take a Newton step of :func:`depth_of`; return the next depth, its bracket, and whether it has converged.

    Args:
        depth: present depth [m].
        low: lower end of the bracket [m].
        high: upper end of the bracket [m].
        total: sum of the points' loads over E at that depth [m³].
        slope: sum of each load over its local penetration [m²].
        load: F / E [m³].
        exponent: exponent of the law.
    """
    if total < load:
        low = depth
    else:
        high = depth
    step = 1.0
    if total > 0:
        step = min(max(math.log(load / total) * total / (exponent * slope * depth), -1.0), 1.0)
    new = depth * math.exp(step)
    found = abs(new - depth) <= _ENOUGH * depth
    if not found and not low < new < high:
        # Where the law is steep at 0, Newton steps may alternate between the ends of the bracket: bisect.
        new = (low + high) / 2.0 if high < NO_END else 2.0 * depth
        if high - low <= _CLOSED * depth:
            new = depth
        found = abs(new - depth) <= _ENOUGH * depth
    return new, low, high, found


@device
def depth_of(gap: FloatArray, weight: FloatArray, count: int, load: float, start: float, law: Law) -> float:
    """Return the depth at which points carry a load under a stress law (:class:`skincal.model.StressLaw`).

    The other arguments are those of :func:`linear_depth`. Under a power law the carried load is nearly a power of the
    depth, so Newton's method works on the logarithms of load and depth, within a bracket.
    """
    _, exponent, reference = law
    depth = linear_depth(gap, weight, count, load, start)
    if exponent == 1.0:
        return depth
    low = 0.0
    high = NO_END
    for _ in range(_LAW_STEPS):
        total = 0.0
        slope = 0.0
        for i in range(count):
            local = depth - gap[i]
            if local > 0:
                stress = reference * (local / reference) ** exponent * weight[i]
                total += stress
                slope += stress / local
        depth, low, high, found = power_step(depth, low, high, total, slope, load, exponent)
        if found:
            return depth
    return depth
