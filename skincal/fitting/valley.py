"""The valley: combinations that the data cannot tell from the best one, and the intervals that bound it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.fitting.fit_options import SearchBox
from skincal.fitting.lattice import best_of_each
from skincal.fitting.presses import Places, PressModel
from skincal.fitting.problem import FitProblem
from skincal.fitting.result import GridResult
from skincal.fitting.types import Floats

UNBOUNDED_FROM = 0.9
"""A parameter whose interval fills this fraction of the searched range is not identified."""

ONE_PLACE = 0.25
"""Presses within this fraction of the patch count as one place."""

POSE = ("across_m", "y_m", "alpha_rad")
"""Names of the pose parameters."""

OPEN = (-np.inf, np.inf)
"""Interval of a parameter that the data do not bound."""


def interval(
    name: str, draws: Sequence[Floats], best: float, box: SearchBox, level: float
) -> tuple[float, float]:
    """Return the central interval of draws, or (-inf, inf) if it fills the searched range.

    Args:
        name: of the parameter.
        draws: values from the valley, (N,) for each contact law; the interval covers that of every law.
        best: the best point; always inside.
        box: the searched ranges.
        level: probability content; 1 for the range of the draws.
    """
    tail = (1.0 - level) / 2
    bounds = np.array([np.quantile(law, [tail, 1.0 - tail]) for law in draws])
    low, high = min(float(bounds[:, 0].min()), best), max(float(bounds[:, 1].max()), best)
    return closed(name, low, high, box)


def closed(name: str, low: float, high: float, box: SearchBox) -> tuple[float, float]:
    """Return an interval, or (-inf, inf) if it fills the searched range: the valley does not close in it."""
    searched = getattr(box, name, None)
    if searched is not None and searched[1] > searched[0]:
        log = name == "elasticity_pa_per_m"
        whole = np.log(searched[1] / searched[0]) if log else np.ptp(searched)
        if (np.log(high / low) if log else high - low) / whole > UNBOUNDED_FROM:
            return OPEN
    return low, high


def extent_m(problem: FitProblem) -> float:
    """Return the larger of the two extents of the presses, across and along [m]."""
    return float(max(np.ptp(problem.across_m), np.ptp(problem.along_m)))


def at_one_place(problem: FitProblem) -> bool:
    """Return whether the presses lie too close together to separate turn and position of the sensor."""
    size = float(np.ptp(problem.rig.layout.centres_m, axis=0).max()) or problem.rig.slack_m
    return extent_m(problem) < ONE_PLACE * size


def valley_loss(model: PressModel, places: Places, points: Floats, rng: np.random.Generator) -> float:
    """Return the loss [counts²] that 98 % of the draws stay below: the bound of the valley that follows from the noise.

    Args:
        model: the presses, with tables around the peak.
        places: possible contact positions of each press.
        points: (N, 11) draws of macro variables and logs of the sigmas.
        rng: selects the draws that are evaluated.
    """
    problem = model.problem
    some = points[rng.choice(len(points), min(60, len(points)), replace=False)]
    state = model.fit_at_places(places, some[:, :5], np.exp(some[:, 5:]), forces_known=True, iterations=10)
    variance = problem.observation.variance(state.sigmas[:, 2], state.sigmas[:, 3], state.press)
    squares = (state.residual**2 * variance).sum(axis=1)
    # Each press at its best position, for each draw.
    each = state.press + np.repeat(np.arange(len(some)) * len(problem), len(places.press))
    best = best_of_each(each, state.objective, len(some) * len(problem))
    total = squares[best].reshape(len(some), -1).sum(axis=1)
    return float(np.quantile(total / max(float((problem.weight > 0).sum()), 1.0), 0.98))


def choose(grid: GridResult, count: int, rng: np.random.Generator) -> Floats:
    """Return draws (N, 5) of the combinations in the valley of a fixed bound; the best one if there is none."""
    inside = np.argwhere(grid.in_valley)
    if len(inside) == 0:
        inside = np.argwhere(grid.mse_counts2 == grid.mse_counts2.min())
    if len(inside) > count:
        # Keep the combinations that bound the valley: their box is the interval.
        edge = {int(f(inside[:, d])) for d in range(4) for f in (np.argmin, np.argmax)}
        scale = grid.scale_per_n[tuple(inside.T)]
        edge |= {int(np.argmin(scale)), int(np.argmax(scale))}
        rest = rng.choice(len(inside), count - len(edge), replace=False)
        inside = inside[np.concatenate([np.array(sorted(edge)), rest])]
    a, e, x, y = inside.T
    axes = grid.grid
    poses = axes.across_m[x], axes.y_m[y], axes.alpha_rad[a]
    return np.column_stack([*poses, np.exp(axes.log_elasticity[e]), grid.scale_per_n[a, e, x, y]])
