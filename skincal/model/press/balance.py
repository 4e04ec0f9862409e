"""The force equilibrium as scalar code: how deep an indenter goes in (paper, equation 5)."""

from __future__ import annotations

import math

from skincal.model.arrays import FloatArray
from skincal.model.press.jit import device

_STEPS = 200
"""Newton steps at most. Ten are usual; every step drops a point, and all but a few of the last drop many."""
_LAW_STEPS = 60
"""Newton steps of a power law at most; three to six are usual."""
_ENOUGH = 1e-12
"""Relative change of the depth in a step below which it is found."""
_CLOSED = 1e-14
"""Relative width of a bracket that rounding no longer lets shrink."""
Law = tuple[float, float, float]
"""E [Pa/m], the exponent (1: linear) and the reference [m] of the law."""
NO_END = math.inf
"""No upper end of the bracket yet."""


@device
def linear_depth(gap: FloatArray, weight: FloatArray, count: int, load: float, start: float) -> float:
    """Return the depth with sum_i w_i max(depth - g_i, 0) = load > 0, exact.

    The carried load is convex and piecewise linear in the depth, with a kink at every gap. Newton's method takes one
    linear piece after the other: from anywhere its first step leads to the solution or above it, from there on it never
    goes below, drops at least one point in every step, and ends where the set of points that carry no longer changes.

    Args:
        gap: (count,) distances beyond the smallest, one of them 0 [m].
        weight: (count,) areas along the contact normal, positive [m²].
        count: number of points, one or more.
        load: F / E [m³].
        start: a depth that the solution is thought to lie near, zero or more [m].
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
    """Take a step of :func:`depth_of`: the next depth, its bracket, and whether the depth is found.

    Args:
        depth: so far [m].
        low: the bracket's lower end [m].
        high: its upper end [m].
        total: sum of the points' loads at that depth [m³].
        slope: sum of each load over its own penetration [m²].
        load: F / E [m³].
        exponent: of the law.
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
        # From the ends of the bracket a step may lead to and fro between them, where the law is steep at 0.
        new = (low + high) / 2.0 if high < NO_END else 2.0 * depth
        if high - low <= _CLOSED * depth:
            new = depth
        found = abs(new - depth) <= _ENOUGH * depth
    return new, low, high, found


@device
def depth_of(gap: FloatArray, weight: FloatArray, count: int, load: float, start: float, law: Law) -> float:
    """Return the depth at which points carry a load under a law (:class:`skincal.model.StressLaw`).

    The other arguments are those of :func:`linear_depth`. Under a power law the carried load grows nearly as a power of
    the depth, so Newton's method is used on its logarithm against the logarithm of the depth, with a bracket that it
    cannot leave.
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
