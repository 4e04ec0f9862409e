"""Press placement: the best contact position of every press within its slack, for any skin and indenter.

For a press with observed values D and simulated values T the objective is

    Q(delta) = sum_j w_j^2 (T_j(delta) - D_j)^2 / sigma_n^2  +  |delta|^2 / sigma_p^2,    |delta_i| <= slack

(the paper's micro variables, section III-B, on absolute images, with the prior of the rig's positions). Pose, E and
scale are known here, so that the size of the image is informative as well. The objective has several local minima: the
mirrored position on the other side of a row of taxels fits almost as well. A lattice finds their basins, and damped
Gauss-Newton steps refine them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skincal.fitting.lattice import best_of_each, minima, square
from skincal.fitting.types import Bools, Floats, Ints

Simulate = Callable[[Floats, Ints], Floats]
"""Function from slacks (n, 2) [m] and the indices of their presses (n,) to values (n, J) [counts], not clipped."""

LATTICE_M, MOST_NODES = 0.4e-3, 21
"""Spacing of the lattice [m], and its largest number of nodes along a side."""

BASINS = 5
"""Largest number of basins of a press that are refined."""

BLUNT_COUNTS = 4.0
"""Smallest noise assumed for residuals on the lattice, so that basins are as wide as its cells."""

DIFFERENCE_M, LONGEST_STEP_M, SETTLED_M = 1e-5, 0.4e-3, 2e-7
"""Step of the finite differences, largest step, and step below which a position has converged [m]."""
STRIDES, ROUNDS = 12, 10
"""Largest numbers of full and of damped steps."""
ROOM = 4_000_000
"""Number of simulated values held in memory at once."""


@dataclass(frozen=True, eq=False)
class ObservedImages:
    """Observed images of K presses whose positions are estimated.

    Attributes:
        values: (K, J) observed values above rest [counts].
        weight: (K, J) weight of a residual; 0 where a taxel was not read.
        saturated: (K, J) the value is a lower bound.
        lit: (K, J) active taxels, from which the noise is estimated.
        floor_counts: lower bound of the noise [counts].
    """

    values: Floats
    weight: Floats
    saturated: Bools
    lit: Bools
    floor_counts: float


@dataclass(frozen=True, eq=False)
class Places:
    """Estimated contact positions.

    Attributes:
        slack_m: (K, 2) best slack across and along [m].
        objective: (K,) Q there.
        noise_counts: noise sigma_n of the residuals [counts].
    """

    slack_m: Floats
    objective: Floats
    noise_counts: float


def best_places(
    simulate: Simulate,
    seen: ObservedImages,
    position_sigma_m: float,
    slack_m: float,
    start: Places | None = None,
) -> Places:
    """Find the best slack of every press.

    Positions are first estimated with a noise of one count. The median residual over the presses, which is robust
    against outliers, is then the noise of the final estimate.

    Args:
        simulate: the skin.
        seen: images of K presses.
        position_sigma_m: one sigma of the measured positions [m]; inf for unknown positions.
        slack_m: bound along each direction, finite [m].
        start: positions found with a similar skin, from which to descend without a lattice.

    Raises:
        ValueError: the bound is negative or not finite.
    """
    if not (np.isfinite(slack_m) and slack_m >= 0):
        raise ValueError(f"slack_m: expected a finite length >= 0; got {slack_m!r}")
    count = len(seen.values)
    is_fixed = slack_m == 0 or position_sigma_m == 0
    problem = _Problem(
        simulate, seen, 0.0 if is_fixed else 1.0 / position_sigma_m**2, 0.0 if is_fixed else slack_m
    )
    if is_fixed or count == 0:
        zero, press = np.zeros((count, 2)), np.arange(count)
        noise = max(seen.floor_counts, 1e-3)
        return Places(zero, problem.evaluate(zero, press, noise)[0], noise)
    press, slack = np.arange(count), np.zeros((count, 2))
    if start is None:
        press, slack = problem.basins(max(seen.floor_counts, BLUNT_COUNTS))
    noise = max(seen.floor_counts, 1.0)
    slack, objective = problem.descend(slack if start is None else start.slack_m, press, noise)
    best = best_of_each(press, objective, count)
    noise = max(seen.floor_counts, problem.typical_residual(slack[best], press[best]))
    slack, objective = problem.descend(slack, press, noise)
    best = best_of_each(press, objective, count)
    return Places(slack[best], objective[best], noise)


@dataclass(frozen=True, eq=False)
class _Best:
    """The best positions so far: slacks (n, 2), objectives (n,) and residuals (n, J), which are updated in place."""

    slack_m: Floats
    objective: Floats
    residual: Floats

    def keep(self, rows: Ints, slack_m: Floats, objective: Floats, residual: Floats) -> Bools:
        """Update the rows whose objective has improved; return which of ``rows`` did."""
        better = objective < self.objective[rows]
        improved = rows[better]
        self.slack_m[improved], self.objective[improved] = slack_m[better], objective[better]
        self.residual[improved] = residual[better]
        return better


@dataclass(frozen=True, eq=False)
class _Problem:
    """The objective of all presses; ``stiffness`` is 1 / sigma_p² [1/m²], ``slack_m`` the bound [m]."""

    simulate: Simulate
    seen: ObservedImages
    stiffness: float
    slack_m: float

    def evaluate(self, slack_m: Floats, press: Ints, noise: float) -> tuple[Floats, Floats]:
        """Return the objective (n,) and the whitened residuals (n, J)."""
        residual = self.residual(slack_m, press) / noise
        return (residual**2).sum(axis=1) + self.stiffness * (slack_m**2).sum(axis=1), residual

    def residual(self, slack_m: Floats, press: Ints) -> Floats:
        """Return the weighted residuals (n, J) [counts]; a taxel at its upper bound gives only a lower bound."""
        seen = self.seen
        difference = self.simulate(slack_m, press) - seen.values[press]
        weight = np.where(seen.saturated[press] & (difference > 0), 0.0, seen.weight[press])
        return np.where(weight > 0, weight * difference, 0.0)

    def basins(self, noise: float) -> tuple[Ints, Floats]:
        """Return presses (n,) and slacks (n, 2) of the local minima of a lattice over the slack's square."""
        half = min(int(np.ceil(self.slack_m / LATTICE_M)), MOST_NODES // 2)
        axis = np.linspace(-self.slack_m, self.slack_m, 2 * half + 1)
        lattice = square(axis)
        count, taxels = self.seen.values.shape
        each = max(1, ROOM // (len(lattice) * taxels))
        found: list[tuple[Ints, Floats]] = []
        for first in range(0, count, each):
            some = np.arange(first, min(first + each, count))
            slack, press = np.tile(lattice, (len(some), 1)), np.repeat(some, len(lattice))
            objective = self.evaluate(slack, press, noise)[0].reshape(len(some), len(axis), len(axis))
            k, node = _lowest_minima(objective)
            found.append((some[k], lattice[node]))
        return np.concatenate([k for k, _ in found]), np.concatenate([at for _, at in found])

    def descend(self, start_m: Floats, press: Ints, noise: float) -> tuple[Floats, Floats]:
        """Refine n starts by Gauss-Newton: return slacks (n, 2) and objectives (n,), never worse than at the start.

        The objective of a press with few active taxels has a narrow curved valley: a full step along it leaves it, and
        the next one returns to it. The best position is kept; damped steps that only descend follow
        (Levenberg-Marquardt).
        """
        best = _Best(start_m.copy(), *self.evaluate(start_m, press, noise))
        rows, now, residual = np.arange(len(press)), best.slack_m, best.residual
        for _ in range(STRIDES):
            trial = self._moved(now, press[rows], residual, np.full(len(rows), 1e-6), noise)
            far = np.abs(trial - now).max(axis=1) > SETTLED_M
            if not far.any():
                break
            rows, now = rows[far], trial[far]
            objective, residual = self.evaluate(now, press[rows], noise)
            best.keep(rows, now, objective, residual)
        rows, damping = np.arange(len(press)), np.full(len(press), 1e-3)
        for _ in range(ROUNDS):
            trial = self._moved(best.slack_m[rows], press[rows], best.residual[rows], damping[rows], noise)
            far = np.abs(trial - best.slack_m[rows]).max(axis=1) > SETTLED_M
            if not far.any():
                break
            rows = rows[far]
            better = best.keep(rows, trial[far], *self.evaluate(trial[far], press[rows], noise))
            damping[rows] *= np.where(better, 0.2, 10.0)
        return best.slack_m, best.objective

    def _moved(self, slack: Floats, press: Ints, residual: Floats, damping: Floats, noise: float) -> Floats:
        """Return slacks (n, 2) after a damped Gauss-Newton step, within the bound [m]."""
        # Finite differences point inwards, to stay within the bound.
        ahead = np.where(slack > 0, -DIFFERENCE_M, DIFFERENCE_M)
        slopes: list[Floats] = []
        for axis in (0, 1):
            moved = slack.copy()
            moved[:, axis] += ahead[:, axis]
            slopes.append((self.residual(moved, press) / noise - residual) / ahead[:, axis : axis + 1])
        slope = np.stack(slopes, axis=-1)
        gradient = np.einsum("njd,nj->nd", slope, residual) + self.stiffness * slack
        hessian = np.einsum("njd,nje->nde", slope, slope)
        # At the bound with an outward gradient, hold that coordinate and step along the other one.
        held = (np.abs(slack) >= self.slack_m * (1 - 1e-12)) & (gradient * slack < 0)
        gradient = np.where(held, 0.0, gradient)
        mixed = np.where(held.any(axis=1), 0.0, hessian[:, 0, 1])
        diagonal = np.einsum("ndd->nd", hessian) + self.stiffness
        # Without information in the image and without a prior, a floor keeps the step finite.
        diagonal = diagonal * (1.0 + damping[:, None]) + 1e-9 * diagonal.sum(axis=1, keepdims=True) + 1.0
        determinant = diagonal.prod(axis=1) - mixed**2
        step = (mixed[:, None] * gradient[:, ::-1] - diagonal[:, ::-1] * gradient) / determinant[:, None]
        step = np.clip(step, -LONGEST_STEP_M, LONGEST_STEP_M)
        return np.clip(slack + step, -self.slack_m, self.slack_m)

    def typical_residual(self, slack_m: Floats, press: Ints) -> float:
        """Return the median over the presses of the rms over lit taxels, corrected for two free coordinates each."""
        lit = self.seen.lit[press]
        squares = np.where(lit, self.residual(slack_m, press) ** 2, 0.0).sum(axis=1)
        number = lit.sum(axis=1)
        if not (number > 2).any():
            return 0.0
        return float(np.sqrt(np.median(squares[number > 2] / (number[number > 2] - 2))))


def _lowest_minima(objective: Floats) -> tuple[Ints, Ints]:
    """Return the lowest local minima of each press's lattice: presses (n,) and flat node indices (n,).

    Args:
        objective: (K, A, A) objective on the lattices.
    """
    low = minima(objective).reshape(len(objective), -1)
    rated = np.where(low, objective.reshape(len(objective), -1), np.inf)
    nodes = np.argsort(rated, axis=1, kind="stable")[:, :BASINS]
    taken = np.isfinite(np.take_along_axis(rated, nodes, axis=1))
    taken[:, 0] = True
    press = np.broadcast_to(np.arange(len(objective))[:, None], nodes.shape)
    return press[taken], nodes[taken]
