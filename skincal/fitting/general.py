"""The macro grid on any geometry: micro problems by nlopt on the skin model itself.

The fast way (:mod:`skincal.fitting.grid`) needs a surface that looks the same everywhere. This one does not: it lays
the patch on the surface at every pose and casts rays at the indenter, as the paper does (section III-B). It answers the
same questions with the same objective, so that both agree where both can be used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.fitting.general_skin import RESOLUTION_M, SkinShares
from skincal.fitting.grid import GridSlab, MacroGrid, least_squares_scale
from skincal.fitting.micro import MicroSettings, micro_objective, nlopt_micro, slack_lattice
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Floats

_TOLERANCE_M = 1e-6
"""The position is sought this finely on the grid; its effect on the loss is far below the noise [m]."""

_APART_M = 0.75e-3
_DOUBTFUL = 4.0
"""A press that is matched worse than this many squared sigmas may have another place that suits better."""


@dataclass(frozen=True, eq=False)
class Combination:
    """One combination of the macro variables, evaluated.

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


def evaluate_slab(
    problem: FitProblem,
    grid: MacroGrid,
    turn: int,
    settings: MicroSettings,
    *,
    resolution_m: float = RESOLUTION_M,
) -> GridSlab:
    """Evaluates all combinations of one turn alpha, as :func:`skincal.fitting.grid.evaluate_slab` does.

    Args:
        problem: presses with contacts in space.
        grid: the macro variables.
        turn: which of the grid's turns.
        settings: of the micro problems.
        resolution_m: cells of the patch [m].

    Returns:
        Loss, scale and slack of every combination (E, X, Y).
    """
    results = np.zeros((3, *grid.shape[1:]))
    for x, across in enumerate(grid.across_m):
        for y, along in enumerate(grid.y_m):
            pose = float(across), float(along), float(grid.alpha_rad[turn])
            skin = SkinShares(problem, *pose, resolution_m=resolution_m)
            found = evaluate_pose(problem, skin, grid.log_elasticity, settings)
            results[:, :, x, y] = np.transpose([(c.mse_counts2, c.scale_per_n, c.slack_rms_m) for c in found])
    return GridSlab(*results)


def evaluate_combination(
    problem: FitProblem,
    across_m: float,
    y_m: float,
    alpha_rad: float,
    log_elasticity: float,
    settings: MicroSettings,
    *,
    resolution_m: float = RESOLUTION_M,
) -> Combination:
    """Evaluates one combination: every press's position by nlopt, then the scale (paper, section III-B).

    Args:
        problem: presses with contacts in space.
        across_m: the sensor's centre round the surface: arc length R beta, or x on a plane [m].
        y_m: the same along the axis [m].
        alpha_rad: turn [rad].
        log_elasticity: logarithm of E in [Pa/m].
        settings: of the micro problems.
        resolution_m: cells of the patch [m].
    """
    skin = SkinShares(problem, across_m, y_m, alpha_rad, resolution_m=resolution_m)
    return evaluate_pose(problem, skin, np.array([log_elasticity]), settings)[0]


def evaluate_pose(
    problem: FitProblem, skin: SkinShares, log_elasticity: Floats, settings: MicroSettings
) -> list[Combination]:
    """Evaluates some elasticities at one pose; a pose at which the taxels do not fit gives no image at all.

    Args:
        problem: presses with contacts in space.
        skin: at the pose.
        log_elasticity: (E,) logarithms of E in [Pa/m].
        settings: of the micro problems.
    """
    weight = np.where(problem.saturated, 0.0, problem.weight)
    observed = problem.values * weight
    log_ratio = np.log(problem.force_n) - log_elasticity[:, None]
    start = _search(problem, skin, log_ratio, observed, weight, settings)
    return [
        _combination(problem, skin, log_ratio[e], observed, weight, start[e], settings)
        for e in range(len(log_elasticity))
    ]


def _search(
    problem: FitProblem,
    skin: SkinShares,
    log_ratio: Floats,
    observed: Floats,
    weight: Floats,
    settings: MicroSettings,
) -> Floats:
    """Starts (E, K, 2, 2) from a lattice [m]: its best slack, and the best of those that lie elsewhere.

    All images of the lattice are made in one batch, which is much cheaper than one by one.
    """
    lattice = slack_lattice(settings.slack_m)
    levels, presses, nodes = len(log_ratio), len(problem), len(lattice)
    press = np.tile(np.repeat(np.arange(presses), nodes), levels)
    slack = np.tile(lattice, (levels * presses, 1))
    shares = skin.shares(press, slack, np.repeat(log_ratio.ravel(), nodes)) * weight[press]
    q = micro_objective(observed[press], shares, slack, settings).reshape(levels, presses, nodes)
    best = q.argmin(axis=-1)
    apart = np.abs(lattice[best][:, :, None] - lattice).max(axis=-1) > _APART_M
    second = np.where(apart, q, np.inf).argmin(axis=-1)
    return np.stack([lattice[best], lattice[second]], axis=2)


def _combination(
    problem: FitProblem,
    skin: SkinShares,
    log_ratio: Floats,
    observed: Floats,
    weight: Floats,
    start_m: Floats,
    settings: MicroSettings,
) -> Combination:
    presses = np.arange(len(problem))
    slack, objective = np.zeros((len(problem), 2)), np.zeros(len(problem))
    for k in range(len(problem)):

        def images(slack_m: Floats, k: int = k) -> Floats:
            same = np.full(len(slack_m), k)
            return skin.shares(same, slack_m, log_ratio[same]) * weight[k]

        found = [
            nlopt_micro(observed[k], images, settings, starts_m=start_m[k, :1], tolerance_m=_TOLERANCE_M)
        ]
        if found[0][1] > _DOUBTFUL:
            again = nlopt_micro(
                observed[k], images, settings, starts_m=start_m[k, 1:], tolerance_m=_TOLERANCE_M
            )
            found.append(again)
        slack[k], objective[k] = min(found, key=lambda one: one[1])
    forces = skin.shares(presses, slack, log_ratio) * weight * problem.force_n[:, None]
    scale, squares = least_squares_scale(forces, observed)
    mse = float(squares) / max(1.0, float((weight > 0).sum()))
    return Combination(mse, float(scale), slack, objective)
