"""The pieces of a fit that can run side by side, each a plain function of one picklable argument.

Who spreads them over processes is up to the caller: a mapper takes a function and a sequence of arguments to the
results in the same order, as the built-in ``map`` does. Results do not depend on it.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from skincal.fitting import general, grid
from skincal.fitting.general_table import ROUGH, SkinTable
from skincal.fitting.general_tabling import joined, run_table, table_tasks
from skincal.fitting.grid import GridSlab, MacroGrid
from skincal.fitting.images import KernelImages
from skincal.fitting.micro import MicroSettings
from skincal.fitting.places import Places
from skincal.fitting.posterior import Bounds, Peak, climb, log_posterior, press_evidence
from skincal.fitting.press_evidence import find_narrow_slacks, log_evidence
from skincal.fitting.problem import FitProblem
from skincal.fitting.seen import Images
from skincal.fitting.selection import log_chance
from skincal.fitting.types import Floats


class Mapper(Protocol):
    """Applies a function to every argument; results come in the order of the arguments."""

    def __call__(self, function: Callable[[Any], Any], arguments: Sequence[Any], /) -> Iterable[Any]:
        """Results in the order of the arguments."""
        ...


@dataclass(frozen=True, eq=False)
class SlabTask:
    """One turn of the macro grid."""

    problem: FitProblem
    grid: MacroGrid
    turn: int
    settings: MicroSettings


def run_slab(task: SlabTask) -> GridSlab:
    """Evaluates one turn of the grid, by tables or by the skin model itself."""
    contacts = task.problem.contacts
    if contacts is None:
        return grid.evaluate_slab(task.problem, task.grid, task.turn, task.settings)
    if contacts.local is None:
        return general.evaluate_slab(task.problem, task.grid, task.turn, task.settings)
    local = contacts.local
    return grid.evaluate_slab(local.problem(task.problem), local.grid(task.grid), task.turn, task.settings)


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Range over which kernels are tabled for the continuous part of a fit.

    Attributes:
        alphas_rad: three turns round the centre [rad].
        log_elasticity: logarithm of E at the centre.
        reach: how far log E may stray from it.
        spread_m: sideways spread of the contact law [m].
        projected: whether taxels feel the projected pressure; otherwise by kernels only.
        table: images of the skin model there, for the general way, which has no kernels.
    """

    alphas_rad: Floats
    log_elasticity: float
    reach: float = 0.9
    spread_m: float = 0.0
    projected: bool = True
    table: SkinTable | None = None

    @classmethod
    def around(cls, macro: Floats, table: SkinTable | None = None) -> Neighbourhood:
        """Centred at macro variables (5,)."""
        alphas = float(macro[2]) + np.radians([-6.0, 0.0, 6.0])
        return cls(alphas, float(macro[3]), table=table)

    def holds(self, macro: Floats) -> bool:
        """Return whether macro variables (5,) lie well inside of what the kernels span."""
        turn, stiffness = abs(macro[2] - self.alphas_rad[1]), abs(macro[3] - self.log_elasticity)
        return bool(turn <= np.radians(5.0) and stiffness <= 0.6)

    def images(self, problem: FitProblem) -> Images:
        """Builds the kernels, or spreads what is tabled."""
        if self.table is not None:
            return self.table.spread(self.spread_m)
        log_force = np.log(problem.force_n)
        span = (
            float(log_force.min()) - self.log_elasticity - self.reach,
            float(log_force.max()) - self.log_elasticity + self.reach,
        )
        rig = problem.rig
        asked = (rig.surface, rig.indenters, rig.layout, self.alphas_rad, span)
        return _kernels(pickle.dumps(asked), self.spread_m, self.projected)


@lru_cache(maxsize=1)
def _kernels(asked: bytes, spread_m: float, projected: bool) -> KernelImages:
    """The kernels that were asked for last: the draws of a fit come in many rounds, all from the same.

    They are known by what they are made of, as every task brings a copy of its own.
    """
    return KernelImages(*pickle.loads(asked), spread_m=spread_m, projected=projected)


@dataclass(frozen=True, eq=False)
class ClimbTask:
    """One climb to a peak of the posterior.

    Attributes:
        problem: the presses.
        bounds: box of the macro variables.
        start: (5,) macro variables.
        around: where images are tabled; None for round the start.
        sigmas: (6,) of a peak nearby, where there is one.
    """

    problem: FitProblem
    bounds: Bounds
    start: Floats
    around: Neighbourhood | None = None
    sigmas: Floats | None = None


def run_climb(task: ClimbTask) -> Peak:
    """Climbs; when the peak lies far from where the kernels were tabled, tables them anew there and goes on."""
    around = task.around
    if around is None:
        table = None
        if task.problem.contacts is not None:
            table = joined([run_table(part) for part in table_tasks(task.problem, task.start, ROUGH)])
        around = Neighbourhood.around(task.start, table)
    peak = climb(task.problem, around.images(task.problem), task.bounds, task.start, sigmas=task.sigmas)
    if around.table is None and not around.holds(peak.macro):
        there = replace(
            Neighbourhood.around(peak.macro), spread_m=around.spread_m, projected=around.projected
        )
        peak = climb(task.problem, there.images(task.problem), task.bounds, peak.macro, sigmas=peak.sigmas)
    return peak


@dataclass(frozen=True, eq=False)
class DensityTask:
    """Log posterior of some points."""

    problem: FitProblem
    around: Neighbourhood
    places: Places
    bounds: Bounds
    points: Floats


def run_density(task: DensityTask) -> Floats:
    """Evaluates the log posterior of the task's points."""
    images = task.around.images(task.problem)
    blocks = np.array_split(task.points, max(1, len(task.points) // 50))
    return np.concatenate([log_posterior(task.problem, images, task.places, task.bounds, b) for b in blocks])


@dataclass(frozen=True, eq=False)
class EvidenceTask:
    """Task: corrections of the log posterior at some points, for the choice of presses and for Laplace."""

    problem: FitProblem
    around: Neighbourhood
    places: Places
    centre: Floats
    points: Floats


def run_evidence(task: EvidenceTask) -> Floats:
    """Return what is to be added to the log posterior (W,) at the task's points (W, 11), up to a constant.

    Presses of one taxel need their evidence by narrow slacks; of the others Laplace's approximation is as good.
    """
    images, problem, at = task.around.images(task.problem), task.problem, task.places
    missing = -log_chance(problem, images, task.points)
    if problem.lone.any():
        slacks = find_narrow_slacks(problem, images, at, task.centre[:5], np.exp(task.centre[5:]))
        missing += log_evidence(problem, images, slacks, task.points)
        missing -= press_evidence(problem, images, at, task.points)[0]
    return missing
