"""The independent tasks of a fit: plain functions of arguments that can be pickled.

The caller decides how to distribute them over processes: a mapper takes a function and a sequence of
arguments, and returns the results in the same order, as the built-in ``map`` does. Results do not depend on
the mapper.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from skincal.fitting import general, grid
from skincal.fitting.expensive_terms import find_narrow_slacks, log_evidence, log_selection_probability
from skincal.fitting.general_table import SkinTable
from skincal.fitting.grid import GridSlab, MacroGrid, MicroSettings
from skincal.fitting.kernel import build_table
from skincal.fitting.lookup import NO_IMAGES, Tables
from skincal.fitting.posterior import Bounds, Peak, climb, log_posterior, press_evidence
from skincal.fitting.presses import Places, PressModel
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Floats

REACH = 0.9
"""How far log E may deviate from the middle of the kernel tables in the continuous part of a fit."""


Mapper = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]
"""Applies a function to every argument; results come in the order of the arguments."""


def evaluate_slab(problem: FitProblem, macro_grid: MacroGrid, turn: int, settings: MicroSettings) -> GridSlab:
    """Evaluate one turn of the grid, by kernel tables or with the skin model."""
    if problem.contacts is None:
        return grid.evaluate_slab(problem, macro_grid, turn, settings)
    local = problem.contacts.local_on_grid
    if local is None:
        return general.evaluate_slab(problem, macro_grid, turn, settings)
    return grid.evaluate_slab(local.problem(problem), local.grid(macro_grid), turn, settings)


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Range of the tables for the continuous part of a fit.

    Attributes:
        alphas_rad: three turns around the centre [rad].
        log_elasticity: log E at the centre.
        spread_m: sideways spread of the contact law [m].
        projected: whether taxels feel the projected pressure; only kernel tables can do otherwise.
        table: image table of the skin model, for the general way; None for kernel tables.
    """

    alphas_rad: Floats
    log_elasticity: float
    spread_m: float = 0.0
    projected: bool = True
    table: SkinTable | None = None

    @classmethod
    def around(cls, macro: Floats, table: SkinTable | None = None) -> Neighbourhood:
        """Return the neighbourhood of macro variables (5,)."""
        alphas = float(macro[2]) + np.radians([-6.0, 0.0, 6.0])
        return cls(alphas, float(macro[3]), table=table)

    def holds(self, macro: Floats) -> bool:
        """Return whether macro variables (5,) lie well inside the tables."""
        if self.table is not None:
            return self.table.holds(macro)
        turn, stiffness = abs(macro[2] - self.alphas_rad[1]), abs(macro[3] - self.log_elasticity)
        return bool(turn <= np.radians(5.0) and stiffness <= 0.6)

    def model(self, problem: FitProblem) -> PressModel:
        """Return the press model with the tables of the neighbourhood."""
        if self.table is not None:
            return PressModel(problem, self.table.spread(self.spread_m).tables())
        log_force = np.log(problem.force_n)
        span = (
            float(log_force.min()) - self.log_elasticity - REACH,
            float(log_force.max()) - self.log_elasticity + REACH,
        )
        rig = problem.rig
        asked = (rig.surface, rig.indenters, rig.layout, self.alphas_rad, span)
        return PressModel(problem, _kernels(pickle.dumps(asked), self.spread_m, self.projected))


@lru_cache(maxsize=1)
def _kernels(asked: bytes, spread_m: float, projected: bool) -> Tables:
    """Return kernel tables; cached, as many rounds of draws ask for the same.

    The key is pickled content, because every task brings its own copy of the objects.
    """
    return Tables(build_table(*pickle.loads(asked), spread_m=spread_m, projected=projected), NO_IMAGES)


def climb_near(
    problem: FitProblem,
    bounds: Bounds,
    start: Floats,
    around: Neighbourhood | None = None,
    sigmas: Floats | None = None,
) -> Peak:
    """Climb to a peak of the posterior; if it leaves the kernel tables, build new ones around it and climb on.

    ``around`` None makes kernel tables around the start; other arguments as for
    :func:`skincal.fitting.posterior.climb`.
    """
    around = around or Neighbourhood.around(start)
    peak = climb(around.model(problem), bounds, start, sigmas=sigmas)
    if around.table is None and not around.holds(peak.macro):
        there = replace(
            Neighbourhood.around(peak.macro), spread_m=around.spread_m, projected=around.projected
        )
        peak = climb(there.model(problem), bounds, peak.macro, sigmas=peak.sigmas)
    return peak


def evaluate_density(
    problem: FitProblem, around: Neighbourhood, places: Places, bounds: Bounds, points: Floats
) -> Floats:
    """Return the log posterior (W,) of points (W, 11); arguments as :func:`skincal.fitting.posterior.log_posterior`."""
    model = around.model(problem)
    blocks = np.array_split(points, max(1, len(points) // 50))
    return np.concatenate([log_posterior(model, places, bounds, block) for block in blocks])


def evaluate_expensive_terms(
    problem: FitProblem, around: Neighbourhood, places: Places, centre: Floats, points: Floats
) -> Floats:
    """Return the terms (W,) of the log posterior that ``log_posterior`` omits, at points (W, 11), up to a constant.

    These are the selection of presses, and the error of the Laplace approximation. The latter is evaluated
    only for presses of one active taxel, by narrow slack priors found at ``centre`` (11,); for other presses
    the approximation is accurate.
    """
    model = around.model(problem)
    missing = -log_selection_probability(model, points)
    if problem.has_one_taxel.any():
        slacks = find_narrow_slacks(model, places, centre[:5], np.exp(centre[5:]))
        missing += log_evidence(model, slacks, points)
        missing -= press_evidence(model, places, points)[0]
    return missing
