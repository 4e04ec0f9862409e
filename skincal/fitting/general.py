"""The macro grid on any geometry: micro problems by nlopt on the skin model itself.

The fast way (:mod:`skincal.fitting.grid`) needs a surface that looks the same everywhere. This one lays the
patch on the surface at every pose, and casts rays at the indenter, as the paper does (section III-B). Both
minimise the same objective. For one press with observed image D and simulated shares g it is

    Q(delta) = |D|^2 (1 - cos^2 angle(D, g(delta))) / sigma^2  +  |delta|^2 / sigma_p^2,    |delta_i| <= slack

The first term is the squared distance of the normalised images, in units of the noise of an image of the size
of D; the second, the prior of the measured position, is not the paper's.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import nlopt  # pyright: ignore[reportMissingTypeStubs]
import numpy as np

from skincal.fitting.general_skin import SkinShares
from skincal.fitting.grid import GridSlab, MacroGrid, MicroSettings, least_squares_scale
from skincal.fitting.lattice import square
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Floats

_APART_M = 0.75e-3
"""A second start differs from the best one by at least this much along one direction [m]."""
_DOUBTFUL = 4.0
"""A press whose objective exceeds this number of squared sigmas is also searched from the second start."""

_TINY = 1e-12
"""Least power of an image, against division by zero."""

_TOLERANCE_M = 1e-6
"""Tolerance of the position [m]; its effect on the loss is far below the noise."""

_DIFFERENCE_M = 5e-6
"""Step of the central differences [m]."""
_CROSS = _DIFFERENCE_M * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Points of the central differences: the centre, and a step to each side along both axes [m]."""

_GIVES_UP: Any = (
    RuntimeError,
    nlopt.RoundoffLimited,  # pyright: ignore
    getattr(nlopt, "runtime_error", RuntimeError),
)
"""Exceptions by which nlopt reports that it cannot improve further, by version."""


@dataclass(frozen=True, eq=False)
class Combination:
    """Result of one combination of the macro variables.

    Attributes:
        mse_counts2, scale_per_n: as in :class:`skincal.fitting.grid.GridSlab`.
        slack_m: (K, 2) best contact positions less the measured ones, across and along [m].
        objective: (K,) of the micro problems.
    """

    mse_counts2: float
    scale_per_n: float
    slack_m: Floats
    objective: Floats

    @property
    def slack_rms_m(self) -> float:
        """Root mean square slack along one direction [m]."""
        return float(np.sqrt((self.slack_m**2).mean()))


def evaluate_slab(problem: FitProblem, grid: MacroGrid, turn: int, settings: MicroSettings) -> GridSlab:
    """Evaluate all combinations of one turn alpha, as :func:`skincal.fitting.grid.evaluate_slab` does."""
    results = np.zeros((3, *grid.shape[1:]))
    for x, across in enumerate(grid.across_m):
        for y, along in enumerate(grid.y_m):
            skin = SkinShares(problem, float(across), float(along), float(grid.alpha_rad[turn]))
            found = evaluate_pose(problem, skin, grid.log_elasticity, settings)
            results[:, :, x, y] = np.transpose([(c.mse_counts2, c.scale_per_n, c.slack_rms_m) for c in found])
    return GridSlab(*results)


def evaluate_pose(
    problem: FitProblem, skin: SkinShares, log_elasticity: Floats, settings: MicroSettings
) -> list[Combination]:
    """Evaluate some elasticities at one pose: every press's position by nlopt, then the scale (paper, section III-B).

    At a pose where the taxels do not fit on the surface, images are zero.
    """
    weight = np.where(problem.saturated, 0.0, problem.weight)
    observed, presses = problem.values * weight, np.arange(len(problem))
    log_ratio = np.log(problem.force_n) - log_elasticity[:, None]
    found: list[Combination] = []
    for ratio, starts in zip(
        log_ratio, _choose_starts(skin, log_ratio, observed, weight, settings), strict=True
    ):
        places = [
            _place_press(skin, k, float(ratio[k]), observed[k], weight[k], starts[k], settings)
            for k in range(len(problem))
        ]
        slack = np.array([one for one, _ in places])
        forces = skin.shares(presses, slack, ratio) * weight * problem.force_n[:, None]
        scale, squares = least_squares_scale(forces, observed)
        mse = float(squares) / max(1.0, float((weight > 0).sum()))
        found.append(Combination(mse, float(scale), slack, np.array([q for _, q in places])))
    return found


def _choose_starts(
    skin: SkinShares, log_ratio: Floats, observed: Floats, weight: Floats, settings: MicroSettings
) -> Floats:
    """Return two starts (E, K, 2, 2) per press from a lattice [m]: its best slack, and the best one far from that.

    All images of the lattice are computed in one batch, which is much cheaper than one by one.
    """
    lattice = slack_lattice(settings.slack_m)
    levels, presses, nodes = len(log_ratio), len(observed), len(lattice)
    press = np.tile(np.repeat(np.arange(presses), nodes), levels)
    slack = np.tile(lattice, (levels * presses, 1))
    shares = skin.shares(press, slack, np.repeat(log_ratio.ravel(), nodes)) * weight[press]
    q = micro_objective(observed[press], shares, slack, settings).reshape(levels, presses, nodes)
    best = q.argmin(axis=-1)
    apart = np.abs(lattice[best][:, :, None] - lattice).max(axis=-1) > _APART_M
    second = np.where(apart, q, np.inf).argmin(axis=-1)
    return np.stack([lattice[best], lattice[second]], axis=2)


def _place_press(
    skin: SkinShares,
    press: int,
    log_ratio: float,
    observed: Floats,
    weight: Floats,
    starts_m: Floats,
    settings: MicroSettings,
) -> tuple[Floats, float]:
    """Return the best slack (2,) of a press [m], and the objective there, by nlopt from its starts (2, 2)."""

    def images(slack_m: Floats) -> Floats:
        same = np.full(len(slack_m), press)
        return skin.shares(same, slack_m, np.full(len(slack_m), log_ratio)) * weight

    best = nlopt_micro(observed, images, settings, starts_m[0])
    if best[1] > _DOUBTFUL:
        best = min(best, nlopt_micro(observed, images, settings, starts_m[1]), key=lambda one: one[1])
    return best


def image_mismatch(observed: Floats, shares: Floats) -> Floats:
    """Return |D|^2 (1 - cos^2) (n,) [counts²] of observed (n, J) and simulated (n, J) images of any scale."""
    power = np.einsum("nj,nj->n", shares, shares)
    product = np.maximum(np.einsum("nj,nj->n", shares, observed), 0.0)
    total = np.einsum("nj,nj->n", observed, observed)
    return total - np.where(power > _TINY, product**2 / np.maximum(power, _TINY), 0.0)


def nlopt_micro(
    observed: Floats, images: Callable[[Floats], Floats], settings: MicroSettings, start_m: Floats
) -> tuple[Floats, float]:
    """Solve one micro problem with nlopt, for any geometry (SLSQP, Kraft 1994, with slopes by differences).

    Args:
        observed: (J,) observed image [counts].
        images: takes slacks (m, 2) [m] to simulated loads (m, J) of any scale.
        settings: noise, stiffness of the slack, bounds.
        start_m: (2,) slack to start from [m].

    Returns:
        Slack (2,) [m] and objective there: the best that was seen.
    """
    best, best_q = np.zeros(2), np.inf

    def objective(slack_mm: Floats, gradient: Floats) -> float:
        nonlocal best, best_q
        slack = np.asarray(slack_mm, dtype=np.float64) * 1e-3
        at = slack + (_CROSS if gradient.size else _CROSS[:1])
        q = micro_objective(observed[None], images(at), at, settings)
        if q[0] < best_q:
            best, best_q = slack, float(q[0])
        if gradient.size:
            gradient[:] = (q[[1, 3]] - q[[2, 4]]) / (2e3 * _DIFFERENCE_M)
        return float(q[0])

    bound = settings.slack_m * 1e3
    if bound <= 0:
        return best, objective(best, np.empty(0))
    solver: Any = nlopt.opt(nlopt.LD_SLSQP, 2)  # pyright: ignore
    solver.set_lower_bounds(-bound)
    solver.set_upper_bounds(bound)
    solver.set_min_objective(objective)
    solver.set_xtol_abs(_TOLERANCE_M * 1e3)
    solver.set_maxeval(200)
    # If the objective is flat to rounding, nlopt raises an error; the best position seen is still valid.
    with suppress(*_GIVES_UP):
        solver.optimize(np.clip(start_m * 1e3, -bound, bound))
    return best, best_q


def micro_objective(observed: Floats, shares: Floats, slack_m: Floats, settings: MicroSettings) -> Floats:
    """Return Q (n,) of observed (n, J) and simulated images (n, J) of any scale, at slacks (n, 2) [m]."""
    observed = np.broadcast_to(observed, shares.shape)
    mismatch = image_mismatch(observed, shares) / settings.sigma_counts**2
    return mismatch + settings.stiffness * (slack_m**2).sum(axis=-1)


def slack_lattice(half_m: float) -> Floats:
    """Return a square lattice (N, 2) of slacks up to ``half_m`` [m].

    Its step is at most 0.5 mm, unless that takes more than 17 nodes per side.
    """
    side = min(2 * int(np.ceil(half_m / 0.5e-3 - 1e-9)) + 1, 17)
    return square(np.linspace(-half_m, half_m, side))
