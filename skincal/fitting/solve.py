"""Run the fit stage by stage: grid, peak, contact law, draws, valley."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import call
from typing import Any, Protocol

import numpy as np

from skincal.fitting.alternatives import (
    LawSpread,
    Nonlinearity,
    candidate_responses,
    weigh_laws,
    weigh_responses,
    with_response,
)
from skincal.fitting.conclude import conclude
from skincal.fitting.fit_options import STEPS, FitOptions, GridSteps, SearchBox
from skincal.fitting.general_table import (
    ROUGH,
    SkinTable,
    TableReach,
    choose_reach,
    join_tables,
    make_table_key,
    split_presses,
    tabulate_presses,
)
from skincal.fitting.grid import GridSlab, MacroGrid, MicroSettings, span
from skincal.fitting.outliers import (
    find_dead_taxels,
    find_dropped_readings,
    find_outlier_presses,
    find_weak_taxels,
)
from skincal.fitting.posterior import Bounds, Peak
from skincal.fitting.problem import COORDINATES, FEW_PRESSES, FitError, FitProblem
from skincal.fitting.result import FitResult, GridResult
from skincal.fitting.sampling import Density, Draws, run_ensemble, sample
from skincal.fitting.tasks import (
    Mapper,
    Neighbourhood,
    climb_near,
    evaluate_density,
    evaluate_expensive_terms,
    evaluate_slab,
)
from skincal.fitting.types import Bools, Floats

MIN_PRESSES = 3
"""Least number of presses of a fit; fewer cannot determine five parameters, however many taxels they load."""

MOST_COMBINATIONS = 5_000_000
"""Largest grid; a larger one would need hours and gigabytes."""

GRID_NOISE = 0.007
"""Lower bound of the noise on the grid, as a fraction of the typical signal. With less noise, no node of the
lattices is near a minimum."""

MIN_EFFECTIVE_DRAWS = 100
"""If importance sampling has a smaller effective sample size, an ensemble of walkers continues from its draws."""

LONE_ROUNDS = 4
"""With presses of one active taxel, sampling stops after this multiple of the fewest rounds. If the effective
sample size is still too small then, the density is rough, and more rounds do not help."""

TERM_POINTS_LONE, TERM_POINTS = 120, 60
"""Number of draws at which :func:`skincal.fitting.tasks.evaluate_expensive_terms` evaluates what is too expensive for
every draw: with presses of one active taxel, where this is rough, and without."""

POLISH_CLIMBS = 2
"""Number of climbs that follow the removal of outliers. Each takes the noise of the readings from the simulated
images of the last peak, and starts from its shared errors."""
RIVAL_NATS, MOST_RIVALS = 30.0, 2
"""In the general way, climbs first take the skin around the sensor to look the same everywhere
(:mod:`skincal.fitting.general_local`). Peaks found so, with a log evidence within ``RIVAL_NATS`` of the best, are
refined with the skin model; at most ``MOST_RIVALS``."""

MOST_STARTS = 4
"""Most grid points from which the continuous part of a fit starts (multistart)."""

MOST_TABLES = 3
"""Most image tables that the general way makes for one peak, if the peak keeps leaving its table."""

Progress = Callable[[str, int, int], None]
"""Progress callback: takes the stage, the number of steps done, and the total."""


class Store(Protocol):
    """Checkpoint of a fit: keeps finished parts between runs."""

    def keep(self, turn: int, slab: GridSlab, /) -> None:
        """Store the results of one turn of the grid."""

    def table(self, name: str, /) -> SkinTable | None:
        """Return the image table stored under a name; None if there is none."""

    def keep_table(self, name: str, table: SkinTable, /) -> None:
        """Store an image table. Tables take most of the time of the general way."""


def default_steps(problem: FitProblem) -> GridSteps:
    """Return the default steps of the macro grid for the method of the fit."""
    if problem.contacts is None:
        return STEPS["fast"]
    return STEPS["nlopt" if problem.contacts.local_on_grid is None else "general"]


def plan_grid(problem: FitProblem, box: SearchBox, options: FitOptions) -> MacroGrid:
    """Lay out the macro grid.

    Raises:
        FitError: there are fewer usable presses than the parameters need, or too many combinations.
    """
    if len(problem) == 0:
        raise FitError("no press can be used")
    if len(problem) < MIN_PRESSES:
        used = f"only {len(problem)} press{'es' if len(problem) > 1 else ''} can be used"
        raise FitError(f"{used}, and the five parameters need at least {MIN_PRESSES}")
    steps = options.steps or default_steps(problem)
    grid = MacroGrid(
        span(*box.across_m, steps.across_m),
        span(*box.y_m, steps.y_m),
        span(*box.alpha_rad, steps.alpha_rad),
        np.log(np.geomspace(*box.elasticity_pa_per_m, steps.elasticities)),
    )
    if grid.combinations > MOST_COMBINATIONS:
        raise FitError(
            f"a grid of {grid.combinations:.2g} combinations is asked for, and {MOST_COMBINATIONS:.0g} is the most: "
            "take coarser steps or narrower ranges; what follows the grid is continuous and needs no finer one"
        )
    return grid


def micro_settings(problem: FitProblem) -> MicroSettings:
    """Return the settings of the micro problems on the grid."""
    sigma = max(GRID_NOISE * problem.observation.typical_counts, problem.noise_sigma_counts)
    return MicroSettings(sigma, problem.rig.position_sigma_m, problem.rig.slack_m)


def solve(
    problem: FitProblem,
    box: SearchBox,
    options: FitOptions,
    rng: np.random.Generator,
    *,
    mapper: Mapper = map,
    slabs: Mapping[int, GridSlab] | None = None,
    store: Store | None = None,
    progress: Progress = lambda _stage, _done, _total: None,
    meanwhile: Callable[[], None] = lambda: None,
) -> FitResult:
    """Run grid search, MAP refinement and posterior sampling.

    Args:
        problem: the presses to fit.
        box: ranges to search.
        options: settings.
        rng: only source of randomness.
        mapper: runs independent tasks, perhaps in parallel; the result does not depend on it.
        slabs: results of turns of the grid that an earlier run has evaluated, by the number of the turn.
        store: checkpoint for finished parts; None for none.
        progress: progress callback.
        meanwhile: called once the workers are mostly idle, so that the caller can start other work there.

    Raises:
        FitError: the presses do not allow a fit.
    """
    grid = plan_grid(problem, box, options)
    low, high = np.array([box.across_m, box.y_m, box.alpha_rad]).T
    edges = np.log([box.elasticity_pa_per_m, problem.scales])
    bounds = Bounds(np.array([*low, *edges[:, 0]]), np.array([*high, *edges[:, 1]]))
    fit = _Fit(bounds, box, options, rng, mapper, store, progress, meanwhile)
    return fit.solve(problem, grid, dict(slabs or {}))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Context of all stages: bounds of the macro variables, and the arguments of :func:`solve`."""

    bounds: Bounds
    box: SearchBox
    options: FitOptions
    rng: np.random.Generator
    mapper: Mapper
    store: Store | None
    progress: Progress
    meanwhile: Callable[[], None]

    def solve(self, problem: FitProblem, grid: MacroGrid, slabs: dict[int, GridSlab]) -> FitResult:
        """Run all stages; see :func:`solve`."""
        settings, for_grid = micro_settings(problem), problem.for_grid
        in_order = self._evaluate_grid(for_grid, grid, settings, slabs)
        problem, kept, dead, peak, around = self._refine(problem, _choose_starts(for_grid, grid, in_order))
        problem, peak, draws = self._draw_posterior(problem, peak, around)
        law, nonlinearity = self._weigh_laws_and_responses(problem, peak, around)
        at = MacroGrid(*draws.mean[:4, None])  # none of the grid's values
        at_best = float(evaluate_slab(for_grid, at, 0, settings).mse_counts2[0, 0, 0])
        mse, scale, slack = (np.stack(arrays) for arrays in zip(*in_order, strict=True))
        fixed = self.options.bound_counts2
        inside = np.zeros(mse.shape, dtype=bool) if fixed is None else mse <= fixed
        evaluated = GridResult(grid, mse, scale, slack, inside, at_best)
        return conclude(
            around.model(problem), peak, draws, evaluated, kept=kept, dead=dead, law=law,
            nonlinearity=nonlinearity, box=self.box, options=self.options, rng=self.rng,
        )  # fmt: skip

    def _map(self, function: Callable[..., Any], arguments: Iterable[Sequence[Any]]) -> Iterable[Any]:
        """Return the results of a function for many argument tuples, by the mapper."""
        return self.mapper(call, [partial(function, *some) for some in arguments])

    def _evaluate_grid(
        self, problem: FitProblem, grid: MacroGrid, settings: MicroSettings, done: dict[int, GridSlab]
    ) -> list[GridSlab]:
        """Evaluate and store the turns of the grid that are missing; return the results of all turns in order."""
        turns = len(grid.alpha_rad)
        missing = [t for t in range(turns) if t not in done]
        self.progress("grid", turns - len(missing), turns)
        found = self._map(evaluate_slab, [(problem, grid, t, settings) for t in missing])
        for turn, slab in zip(missing, found, strict=True):
            done[turn] = slab
            if self.store is not None:
                self.store.keep(turn, slab)
            self.progress("grid", len(done), turns)
        return [done[t] for t in range(turns)]

    def _climb_all(self, problem: FitProblem, bounds: Bounds, starts: Iterable[Floats]) -> list[Peak]:
        """Climb from each start on kernel tables; return the peaks, the largest evidence (Laplace) first."""
        peaks = self._map(climb_near, [(problem, bounds, start) for start in starts])
        return sorted(peaks, key=lambda peak: -peak.log_evidence)

    def _refine(
        self, problem: FitProblem, starts: list[Floats]
    ) -> tuple[FitProblem, Bools, Bools, Peak, Neighbourhood]:
        """Find the highest peak, and leave out dead taxels, dropped readings and outlier presses.

        Returns:
            Reduced problem, mask of kept presses, mask of dead taxels, peak, and the tables around it.
        """
        self.progress("peak", 0, 2)
        weak = find_weak_taxels(problem)
        strong = problem.without_taxels(weak) if weak.any() else problem
        general = problem.contacts is not None
        if general:
            starts = self._local_peaks(strong, starts)
            near = [Neighbourhood.around(s, self._table(strong, s, ROUGH)) for s in starts]
            rough = (
                climb_near(strong, self.bounds, s, around) for s, around in zip(starts, near, strict=True)
            )
            peak = max(rough, key=lambda one: one.log_evidence)
        else:
            peak = self._climb_all(strong, self.bounds, starts)[0]
        peak, around = self._tabulate_around(strong, peak)
        # From here on, single climbs follow each other near this peak, so workers are idle.
        self.meanwhile()
        dead = find_dead_taxels(problem, peak.states)
        if dead.any():
            problem = problem.without_taxels(dead)
        if (dead ^ weak).any():
            peak = climb_near(problem, self.bounds, peak.macro, around)
        self.progress("peak", 1, 2)
        lost = find_dropped_readings(problem, peak.states, float(peak.sigmas[4]))
        if lost.any():
            # Only a climb with shared errors estimates the spread of the gains. Judge the
            # readings again with that spread, so that a taxel of low gain is not taken for a
            # dropped reading.
            without = climb_near(problem.without_readings(lost), self.bounds, peak.macro, around, peak.sigmas)
            lost = find_dropped_readings(problem, peak.states, float(without.sigmas[4]))
            problem = problem.without_readings(lost)
            peak = climb_near(problem, self.bounds, without.macro, around)
        keep = ~find_outlier_presses(problem, peak)
        if not keep.all():
            problem = problem.subset(keep, "glitch: its image or force does not fit with the other presses")
            again: list[tuple[Any, ...]] = [(problem, self.bounds, peak.macro, around)]
            if not general:  # an image table only covers the neighbourhood of its own peak
                again.append((problem, self.bounds, starts[0], None))
            peak = max(self._map(climb_near, again), key=lambda one: one.log_evidence)
        for _ in range(POLISH_CLIMBS):
            problem = problem.with_signal(peak.states.simulated).with_shared(peak.theta)
            peak = climb_near(problem, self.bounds, peak.macro, around, peak.sigmas)
        if not around.holds(peak.macro):
            peak, around = self._tabulate_around(problem, peak)
        self.progress("peak", 2, 2)
        return problem.with_shared(peak.theta), keep, dead, peak, around

    def _local_peaks(self, problem: FitProblem, starts: list[Floats]) -> list[Floats]:
        """Climb on the uniform local surface; return the best peak and near rivals (macro variables)."""
        assert problem.contacts is not None
        local = problem.contacts.local_on_grid
        if local is None:
            return starts
        # Arc lengths may put the centre slightly outside the box; clip it.
        peaks = self._climb_all(local.problem(problem), local.bounds(self.bounds), map(local.arcs, starts))
        reach = np.array([ROUGH.centre_m, ROUGH.centre_m, ROUGH.alpha_rad, ROUGH.log_ratio, np.inf])
        found: list[Floats] = []
        for peak in peaks:
            macro = np.clip(local.labels(peak.macro), self.bounds.low, self.bounds.high)
            near = peaks[0].log_evidence - peak.log_evidence < RIVAL_NATS
            if near and all((np.abs(macro - other) > 0.5 * reach).any() for other in found):
                found.append(macro)
        return found[:MOST_RIVALS]

    def _table(self, problem: FitProblem, macro: Floats, reach: TableReach) -> SkinTable:
        """Return an image table of all presses; compute the parts that the checkpoint does not have."""
        arguments = [(problem, presses, macro, reach) for presses in split_presses(problem)]
        names = [make_table_key(*some) for some in arguments]
        parts = [None if self.store is None else self.store.table(name) for name in names]
        missing = [n for n, part in enumerate(parts) if part is None]
        done = len(names) - len(missing)
        self.progress("images", done, len(names))
        made = self._map(tabulate_presses, [arguments[n] for n in missing])
        for n, part in zip(missing, made, strict=True):
            parts[n], done = part, done + 1
            if self.store is not None:
                self.store.keep_table(names[n], part)
            self.progress("images", done, len(names))
        return join_tables([part for part in parts if part is not None])

    def _tabulate_around(self, problem: FitProblem, peak: Peak) -> tuple[Peak, Neighbourhood]:
        """Return the peak and the tables around it; in the general way, table images and climb again on them."""
        if problem.contacts is None:
            return peak, Neighbourhood.around(peak.macro)
        around, tries = None, 0
        while around is None or (tries < MOST_TABLES and not around.holds(peak.macro)):
            around = Neighbourhood.around(peak.macro, self._table(problem, peak.macro, choose_reach(peak)))
            peak, tries = climb_near(problem, self.bounds, peak.macro, around), tries + 1
        return peak, around

    def _draw_posterior(
        self, problem: FitProblem, peak: Peak, around: Neighbourhood
    ) -> tuple[FitProblem, Peak, Draws]:
        """Draw from the posterior around a peak; return the problem and the peak that the draws belong to, too.

        With very little noise, presses of one active taxel make the density too rough to sample. Those
        presses are then left out.
        """
        draws, density = self._sample(problem, peak, around)
        worth, lone = min(MIN_EFFECTIVE_DRAWS, self.options.enough_draws), problem.has_one_taxel
        if draws.effective < worth and lone.any() and (~lone).sum() >= FEW_PRESSES:
            problem = problem.subset(~lone, "1 active taxel, beside presses of more that tell far more")
            problem = replace(problem, min_active=COORDINATES)
            peak = climb_near(problem, self.bounds, peak.macro, around, peak.sigmas)
            problem = problem.with_shared(peak.theta)
            draws, density = self._sample(problem, peak, around)
        if draws.effective < worth:
            draws = max(draws, run_ensemble(density, draws, self.rng), key=lambda d: d.effective)
        return problem, peak, draws

    def _sample(self, problem: FitProblem, peak: Peak, around: Neighbourhood) -> tuple[Draws, Density]:
        """Run importance sampling around a peak; return the draws and the density that they follow."""
        fewest, most = self.options.rounds
        lone = bool(problem.has_one_taxel.any())

        def in_two_parts(function: Callable[..., Floats], about: object, points: Floats) -> Floats:
            # Split into a fixed number of parts, so that results do not depend on the number of
            # workers.
            parts = [(problem, around, peak.places, about, part) for part in np.array_split(points, 2)]
            return np.concatenate(list(self._map(function, parts)))

        self.progress("draws", 0, fewest)
        return sample(
            peak,
            problem,
            lambda points: in_two_parts(evaluate_density, self.bounds, points),
            self.rng,
            size=self.options.round_size,
            rounds=(fewest, min(most, LONE_ROUNDS * fewest) if lone else most),
            enough_draws=self.options.enough_draws,
            expensive_term=lambda points: in_two_parts(evaluate_expensive_terms, points.mean(axis=0), points),
            term_points=TERM_POINTS_LONE if lone else TERM_POINTS,
            on_round=lambda done: self.progress("draws", min(done, fewest), fewest),
        )

    def _weigh_laws_and_responses(
        self, problem: FitProblem, peak: Peak, around: Neighbourhood
    ) -> tuple[LawSpread, Nonlinearity]:
        """Weigh contact laws and nonlinear responses by their evidence; every climb restarts from the peak."""
        spreads = self.options.law_spreads_m
        self.progress("contact law", 0, 1)

        spread_tasks = [
            (problem, self.bounds, peak.macro, replace(around, spread_m=spread), peak.sigmas)
            for spread in spreads[1:]
        ]
        unprojected_tasks: list[tuple[Any, ...]] = []
        local = None if problem.contacts is None else problem.contacts.local
        if spread_tasks and problem.contacts is None:
            unprojected_tasks = [
                (problem, self.bounds, peak.macro, replace(around, projected=False), peak.sigmas)
            ]
        elif spread_tasks and local is not None:
            # Image tables contain the projections. Compare taxels that feel the pressure itself
            # by kernels instead, on the uniform local surface; where there is none, skip the
            # comparison.
            start = local.arcs(peak.macro)
            plain = Neighbourhood.around(start)
            unprojected_tasks = [
                (local.problem(problem), local.bounds(self.bounds), start, law, peak.sigmas)
                for law in (plain, replace(plain, projected=False))
            ]
        candidates = candidate_responses(problem)
        response_tasks = [
            (with_response(problem, one), self.bounds, peak.macro, around, peak.sigmas) for one in candidates
        ]
        peaks: list[Peak] = list(self._map(climb_near, [*spread_tasks, *unprojected_tasks, *response_tasks]))
        self.progress("contact law", 1, 1)
        first, last = len(spread_tasks), len(spread_tasks) + len(unprojected_tasks)
        laws, unprojected_peaks, response_peaks = [peak, *peaks[:first]], peaks[first:last], peaks[last:]
        # The first candidate is the straight response. It restarts from the peak like all others, so
        # that no law or response wins only because the restart found better contact positions.
        laws[0] = max(peak, response_peaks[0], key=lambda one: one.log_evidence)
        comparable = laws + (unprojected_peaks if len(unprojected_tasks) == 1 else [])
        # Run these in a worker, which has already imported SciPy for the search of the taxel order.
        [nonlinearity] = self._map(weigh_responses, [(problem, comparable, candidates, response_peaks)])
        [law] = self._map(weigh_laws, [(np.array(spreads), laws)])
        if unprojected_tasks:
            law = law.with_unprojected(
                laws[0] if len(unprojected_tasks) == 1 else unprojected_peaks[0], unprojected_peaks[-1]
            )
        return law, nonlinearity


def _choose_starts(problem: FitProblem, grid: MacroGrid, slabs: Sequence[GridSlab]) -> list[Floats]:
    """Return the best grid points that are not neighbours of each other, as macro variables (5,)."""
    mse, scale, slack = (np.stack(arrays) for arrays in zip(*slabs, strict=True))
    # Normalised images do not determine contact positions fully. The loss that remains at the best grid
    # point is mostly due to that, and serves as the noise here.
    noise = max(float(mse.min()), problem.noise_sigma_counts**2)
    sigma = problem.rig.position_sigma_m
    stiff = 1.0 / sigma**2 if np.isfinite(sigma) and sigma > 0 else 0.0
    lit = float(problem.lit.sum())
    score = mse / noise * lit + 2 * len(problem) * slack**2 * stiff
    score = np.where(scale > 0, score, np.inf)
    starts: list[Floats] = []
    for flat in np.argsort(score, axis=None)[:4000]:
        a, e, x, y = (int(i) for i in np.unravel_index(int(flat), score.shape))
        if not np.isfinite(score[a, e, x, y]):
            break
        point = np.array([
            grid.across_m[x], grid.y_m[y], grid.alpha_rad[a], grid.log_elasticity[e], np.log(scale[a, e, x, y])
        ])  # fmt: skip
        apart = np.array([1.2e-3, 1.2e-3, np.radians(7.0), 0.5, np.inf])
        if all((np.abs(point - s) > apart).any() for s in starts):
            starts.append(point)
        if len(starts) == MOST_STARTS:
            break
    if not starts:
        raise FitError(
            "no combination of the grid gives an image at all; the sensor lies where nothing was pressed. Widen the "
            "ranges of [mount], or check that positions are in the fingertip frame"
        )
    return starts
