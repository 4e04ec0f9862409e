"""The macro grid on any geometry: micro problems by nlopt on the skin model itself.

The fast way (:mod:`skincal.fitting.grid`) needs a surface that looks the same everywhere. This one does not:
it lays the patch on the surface at every pose, and casts rays at the indenter, as the paper does (section
III-B). It minimises the same objective, so that both agree where both can be used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.fitting.general_skin import SkinShares
from skincal.fitting.grid import GridSlab, MacroGrid, least_squares_scale
from skincal.fitting.micro import MicroSettings, micro_objective, nlopt_micro, slack_lattice
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Floats

_APART_M = 0.75e-3
"""A second start differs from the best one by at least this much along one direction [m]."""
_DOUBTFUL = 4.0
"""A press whose objective exceeds this number of squared sigmas is also searched from the second start."""


@dataclass(frozen=True, eq=False)
class Combination:
    """Result of one combination of the macro variables.

    Attributes:
        mse_counts2: the paper's loss: mean squared error per taxel with the best positions and scale [counts²].
        scale_per_n: least-squares scale S [1/N].
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
    """Evaluate all combinations of one turn alpha, as :func:`skincal.fitting.grid.evaluate_slab` does.

    Args:
        problem: presses with contacts in space.
        grid: the macro variables.
        turn: number of the turn.
        settings: of the micro problems.

    Returns:
        Loss, scale and slack of every combination (E, X, Y).
    """
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

    Args:
        problem: presses with contacts in space.
        skin: at the pose.
        log_elasticity: (E,) logs of E in [Pa/m].
        settings: of the micro problems.
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
