"""How stress grows with local penetration, where it does not grow in proportion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import FloatArray, positive
from skincal.model.equilibrium import Settled

_STEPS = 60
"""Newton steps at most; three to six are usual."""
_ENOUGH = 1e-12
"""Relative change of the depth in a step below which it is found."""
_CLOSED = 1e-14
"""Relative width of a bracket that rounding no longer lets shrink."""
_ROOM = 1.2
"""Points are taken into account as far as so many times the depth that was guessed."""


@dataclass(frozen=True)
class StressLaw:
    """A power law: sigma = E eps_0 (eps / eps_0)^n.

    With n = 1 the paper's elastic foundation (equation 3); n > 1 stiffens, as a foam or a rubber that is nearly
    pressed through (Johnson, Contact Mechanics, 1985, section 4.3, on the foundation; the power law is the usual
    first step beyond it).

    Attributes:
        exponent: n.
        reference_m: eps_0, the penetration at which the stress is that of the linear law [m].
    """

    exponent: float
    reference_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "exponent", positive("law exponent", self.exponent))
        object.__setattr__(self, "reference_m", positive("law reference_m", self.reference_m))

    def effective_m(self, penetration_m: FloatArray) -> FloatArray:
        """The penetration at which the linear law has the same stress, of the same shape [m]."""
        relative: FloatArray = penetration_m / self.reference_m
        np.power(relative, self.exponent, out=relative)
        relative *= self.reference_m
        return relative


def settle_under(law: StressLaw, linear: Settled, load_m3: FloatArray) -> Settled:
    """The depth at which a law other than the linear one carries the load.

    The carried load grows with the depth nearly as a power, so Newton's method is used on its logarithm against the
    logarithm of the depth, with a bracket that it cannot leave.

    Args:
        law: how stress grows with penetration.
        linear: the equilibrium under the linear law.
        load_m3: (K,) F / E [m³].

    Returns:
        The same with other depths.
    """
    depth = linear.depth_m.copy()
    open_ = depth > 0
    reach = _ROOM * depth
    while open_.any():
        rows = np.flatnonzero(open_)
        depth[rows] = _depth(law, linear, load_m3, rows, reach[rows], depth[rows])
        open_ = open_ & (depth > reach)
        reach[open_] = _ROOM * depth[open_]
    return Settled(linear.first_m, depth, linear.gap_m, linear.weight_m2)


def _depth(
    law: StressLaw,
    linear: Settled,
    load: FloatArray,
    rows: np.ndarray[tuple[int], np.dtype[np.intp]],
    reach: FloatArray,
    start: FloatArray,
) -> FloatArray:
    """Depths of some rows, as if points beyond a reach did not exist: too deep if anything."""
    near = (linear.gap_m[rows] < reach[:, None]) & (linear.weight_m2[rows] > 0)
    row = np.nonzero(near)[0]
    gap, weight = linear.gap_m[rows][near], linear.weight_m2[rows][near]
    target, depth = load[rows], start.copy()
    low, high = np.zeros(len(rows)), np.full(len(rows), np.inf)
    for _ in range(_STEPS):
        local = np.maximum(depth[row] - gap, 0.0)
        stress = law.effective_m(local) * weight
        total = np.bincount(row, stress, len(rows))
        # d(log stress) = n d(log local): the slope of a point is its stress times n over its penetration.
        slope = np.bincount(
            row, np.divide(stress, local, out=np.zeros_like(local), where=local > 0), len(rows)
        )
        low, high = np.where(total < target, depth, low), np.where(total >= target, depth, high)
        step = np.log(target / total) * total / (law.exponent * slope * depth)
        new = depth * np.exp(np.clip(step, -1.0, 1.0))
        close = np.abs(new - depth) <= _ENOUGH * depth
        # From the ends of the bracket a step may lead to and fro between them, as it does where the law is steep at 0.
        new = np.where(close | ((new > low) & (new < high)), new, _between(low, high, depth))
        done = np.abs(new - depth) <= _ENOUGH * depth
        depth = new
        if done.all():
            break
    return depth


def _between(low: FloatArray, high: FloatArray, depth: FloatArray) -> FloatArray:
    """A depth inside a bracket; where it is closed but for rounding, the depth itself."""
    middle = np.where(np.isfinite(high), (low + high) / 2, 2 * depth)
    return np.where(high - low <= _CLOSED * depth, depth, middle)
