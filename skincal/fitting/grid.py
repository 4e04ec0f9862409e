"""The macro variables on a grid: sensor pose y, beta, alpha and elasticity E, with the micro problems inside."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skincal.fitting.kernel import build_table
from skincal.fitting.problem import FitProblem
from skincal.fitting.slab import place
from skincal.fitting.types import Floats, Ints
from skincal.model.press.jit import reporting_compilation

_SEARCH_STEP_M = 0.25e-3
"""Step of the lattice that is searched for the start of Gauss-Newton [m]."""


@dataclass(frozen=True, eq=False)
class MacroGrid:
    """The values of each macro variable.

    Attributes:
        across_m: (X,) positions of the sensor's centre around the surface: arc length R beta, or x [m].
        y_m: (Y,) positions along the axis [m].
        alpha_rad: (A,) turns [rad].
        log_elasticity: (E,) logs of E in [Pa/m].
    """

    across_m: Floats
    y_m: Floats
    alpha_rad: Floats
    log_elasticity: Floats

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(A, E, X, Y)."""
        return len(self.alpha_rad), len(self.log_elasticity), len(self.across_m), len(self.y_m)

    @property
    def combinations(self) -> int:
        """Number of combinations of the grid."""
        return int(np.prod(self.shape))


@dataclass(frozen=True)
class MicroSettings:
    """Weights of image residual and slack.

    Attributes:
        sigma_counts: standard deviation of an image residual [counts].
        position_sigma_m: standard deviation of the measured contact position [m]; inf for no prior.
        slack_m: bound of the slack along each direction [m].
    """

    sigma_counts: float
    position_sigma_m: float
    slack_m: float

    @property
    def stiffness(self) -> float:
        """1 / sigma_p^2 [1/m²]."""
        return 1.0 / self.position_sigma_m**2 if np.isfinite(self.position_sigma_m) else 0.0


class GridSlab(NamedTuple):
    """Results of one turn of the sensor, each array (E, X, Y).

    Attributes:
        mse_counts2: the paper's loss: mean squared error per taxel with the best positions and scale [counts²].
        scale_per_n: least-squares scale S [1/N].
        slack_rms_m: root mean square slack along one direction [m].
    """

    mse_counts2: Floats
    scale_per_n: Floats
    slack_rms_m: Floats


def span(low: float, high: float, step: float) -> Floats:
    """Return equally spaced values from ``low`` to ``high``, both included, no further apart than ``step``."""
    if high <= low:
        return np.array([low])
    return np.linspace(low, high, int(np.ceil((high - low) / step - 1e-9)) + 1)


def least_squares_scale(forces: Floats, observed: Floats) -> tuple[Floats, Floats]:
    """Return the scale S that maps taxel forces to observed values, and the sum of squares that is left.

    Args:
        forces: (K, ..., J) weighted loads of K presses [N].
        observed: (K, ..., J) weighted values [counts].

    Returns:
        S (...) [1/N], 0 if no taxel is loaded, and the sum of squared residuals (...) [counts²].
    """
    power = np.einsum("k...j,k...j->...", forces, forces)
    product = np.einsum("k...j,k...j->...", forces, observed)
    scale = np.where(power > 0, product / np.maximum(power, 1e-30), 0.0)
    return scale, np.einsum("k...j,k...j->...", observed, observed) - scale * product


def evaluate_slab(problem: FitProblem, grid: MacroGrid, turn: int, settings: MicroSettings) -> GridSlab:
    """Evaluate all combinations of one turn alpha."""
    rig, log_force = problem.rig, np.log(problem.force_n)
    ratios = (log_force.min() - grid.log_elasticity[-1], log_force.max() - grid.log_elasticity[0])
    table = build_table(rig.surface, rig.indenters, rig.layout, grid.alpha_rad[turn : turn + 1], ratios)
    weight = np.where(problem.saturated, 0.0, problem.weight)
    observed = (problem.values * weight)[:, None, None]
    results = np.zeros((3, *grid.shape[1:]))
    for e, log_elasticity in enumerate(grid.log_elasticity):
        level = table.level(0, log_force - log_elasticity, problem.indenter)
        slack, shares = place_presses(problem, grid, turn, settings, table.size_of, level)
        forces = shares * problem.force_n[:, None, None, None]
        scale, squares = least_squares_scale(forces, np.broadcast_to(observed, forces.shape))
        mse = squares / max(1.0, float((weight > 0).sum()))
        results[:, e] = mse, scale, np.sqrt((slack**2).mean(axis=(0, 3)))
    return GridSlab(*results)


def _build_axis(centres: Floats, slack: float) -> tuple[Floats, Floats, int]:
    """Return lattice offsets (P,), the slacks of a search window, and the number of nodes from centre to centre.

    Offsets are slack minus centre, in ascending order, so the last centre comes first.
    """
    pitch = float(centres[1] - centres[0]) if len(centres) > 1 else _SEARCH_STEP_M
    stride = max(1, int(np.ceil(pitch / _SEARCH_STEP_M - 1e-9)))
    step = pitch / stride
    half = int(slack / step + 1e-9)
    window = np.arange(-half, half + 1) * step
    # Start at the last centre, so that the offsets ascend.
    offsets = -float(centres[-1]) + np.arange(-half, half + (len(centres) - 1) * stride + 1) * step
    return offsets, window, stride


def place_presses(
    problem: FitProblem,
    grid: MacroGrid,
    turn: int,
    settings: MicroSettings,
    size_of: Ints,
    level: tuple[NDArray[np.float32], tuple[float, float, Floats]],
) -> tuple[Floats, Floats]:
    """Return slacks (K, X, Y, 2) [m] of every press under every centre, and its weighted load shares (K, X, Y, J).

    All combinations share one lattice of contact positions per press, relative to the sensor's centre. It is
    placed so that each grid value of the centre, with zero slack, falls on a node. ``level`` is from
    :meth:`skincal.fitting.lookup.KernelTable.level`.
    """
    planes, lattice = level
    rows, slack_rows, row_stride = _build_axis(grid.across_m, settings.slack_m)
    cols, slack_cols, col_stride = _build_axis(grid.y_m, settings.slack_m)
    weight = np.where(problem.saturated, 0.0, problem.weight)
    shape = (len(problem), len(grid.across_m), len(grid.y_m))
    taxels, alpha = problem.rig.layout.taxels, float(grid.alpha_rad[turn])
    slack, shares = np.zeros((*shape, 2)), np.empty((*shape, taxels))
    press_workspace = np.empty((3, taxels)), np.empty(taxels, dtype=np.int64)
    workspace = np.empty((len(rows), len(cols))), *np.empty((2, len(grid.y_m), len(rows))), press_workspace
    how = 1.0 / settings.sigma_counts**2, settings.stiffness, settings.slack_m
    with reporting_compilation():
        place(
            # A copy is writable in all processes; a read-only array would be a second type to
            # compile.
            (planes, size_of, problem.rig.layout.centres_m.copy(), lattice),
            (weight, problem.values * weight),
            (problem.across_m[:, None] + rows, problem.along_m[:, None] + cols),
            (problem.across_m[:, None] - grid.across_m, problem.along_m[:, None] - grid.y_m),
            (slack_rows, slack_cols),
            (row_stride, col_stride),
            ((float(np.cos(alpha)), float(np.sin(alpha))), how),
            (slack, shares),
            workspace,
        )
    return slack, shares
