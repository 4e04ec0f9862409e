"""The fit, stage by stage: grid, peak, contact law, draws, valley."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import call
from typing import Any, Protocol

import numpy as np

from skincal.fitting.conclude import conclude
from skincal.fitting.fit_options import STEPS, FitOptions, GridSteps, SearchBox
from skincal.fitting.general_table import (
    ROUGH,
    SkinTable,
    TableReach,
    joined,
    name_of,
    parts_of,
    reach_of,
    run_table,
)
from skincal.fitting.grid import GridSlab, MacroGrid, span
from skincal.fitting.law import LawSpread, weigh_laws
from skincal.fitting.micro import MicroSettings
from skincal.fitting.posterior import Bounds, Peak
from skincal.fitting.problem import COORDINATES, FEW_PRESSES, FitError, FitProblem
from skincal.fitting.response import Bend, responses, weigh_bends, with_response
from skincal.fitting.result import FitResult, GridResult
from skincal.fitting.robust import dead_taxels, glitches, lost_readings, weak_taxels
from skincal.fitting.sampling import Density, Draws, sample, walk
from skincal.fitting.tasks import Mapper, Neighbourhood, climb_near, density_at, evaluate_slab, lacking_at
from skincal.fitting.types import Bools, Floats

LEAST_TO_FIT = 3
"""Fewer cannot tell five parameters, however many taxels they light."""

MOST_COMBINATIONS = 5_000_000
"""A grid of more would need hours and gigabytes."""

GRID_NOISE = 0.007
"""Noise on the grid as a part of the usual signal, at least: with less, no node of its lattices is near a minimum."""

WORTH = 100
"""Importance sampling whose draws are worth fewer independent ones gives way to an ensemble of walkers."""

ROUGH_ROUNDS = 2
"""Times the fewest rounds after which draws that are worth too little tell that a density is rough."""

CHECKED, SMOOTH = 120, 60
"""Draws at which it is found what the log posterior misses, :func:`skincal.fitting.tasks.lacking_at`: with presses of
one taxel, where it is rough, and without."""

POLISH = 2
"""Times that a peak is climbed anew with the noise of readings as simulated images have it, and with shared errors."""
RIVAL, RIVALS = 30.0, 2
"""Peaks of the local surface within so much log evidence of its best are looked at by the skin model, the best few."""

STARTS = 4
"""Grid points that the continuous part of a fit begins from, at most."""

TABLES = 3
"""A peak of the general way that leaves the table it was climbed on is tabled anew so many times at most."""

Progress = Callable[[str, int, int], None]
"""Told the stage, how much of it is done, and of how much."""


class Store(Protocol):
    """Keeps parts of a fit between its runs."""

    def keep(self, turn: int, slab: GridSlab, /) -> None:
        """Keep a turn of the grid."""
        ...

    def table(self, name: str, /) -> SkinTable | None:
        """The table of images that was kept under a name; None where there is none."""
        ...

    def keep_table(self, name: str, table: SkinTable, /) -> None:
        """Keep a table of images, on which the general way spends its time."""
        ...


def default_steps(problem: FitProblem) -> GridSteps:
    """Steps of the macro grid that the way of the fit affords."""
    if problem.contacts is None:
        return STEPS["fast"]
    return STEPS["nlopt" if problem.contacts.on_grid is None else "general"]


def plan_grid(problem: FitProblem, box: SearchBox, options: FitOptions) -> MacroGrid:
    """Lay out the macro grid.

    Raises:
        FitError: no press can be used, or fewer than the parameters need; or there are too many combinations.
    """
    if len(problem) == 0:
        raise FitError("no press can be used")
    if len(problem) < LEAST_TO_FIT:
        used = f"only {len(problem)} press{'es' if len(problem) > 1 else ''} can be used"
        raise FitError(f"{used}, and the five parameters need at least {LEAST_TO_FIT}")
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
    """Fits.

    Args:
        problem: presses that are used.
        box: ranges to search.
        options: settings.
        rng: the only source of chance.
        mapper: spreads independent work; the result does not depend on it.
        slabs: turns of the grid that have been evaluated before.
        store: keeps what is done, so that another run need not do it again.
        progress: told how far the work is.
        meanwhile: called when workers have nothing to do for a while, to begin what the fit does not need.

    Returns:
        Best point, intervals, grid, draws, and what a person should know.

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
    """What all stages of a fit need: bounds of the macro variables, and the arguments of :func:`solve`."""

    bounds: Bounds
    box: SearchBox
    options: FitOptions
    rng: np.random.Generator
    mapper: Mapper
    store: Store | None
    progress: Progress
    meanwhile: Callable[[], None]

    def solve(self, problem: FitProblem, grid: MacroGrid, slabs: dict[int, GridSlab]) -> FitResult:
        """See :func:`solve`."""
        settings, on_grid = micro_settings(problem), problem.on_grid
        in_order = self._on_grid(on_grid, grid, settings, slabs)
        problem, kept, dead, peak, around = self._refine(problem, _starts(on_grid, grid, in_order))
        problem, peak, draws = self._drawn(problem, peak, around)
        law, bend = self._laws_and_bends(problem, peak, around)
        at = MacroGrid(*draws.mean[:4, None])  # none of the grid's values
        at_best = float(evaluate_slab(on_grid, at, 0, settings).mse_counts2[0, 0, 0])
        mse, scale, slack = (np.stack(arrays) for arrays in zip(*in_order, strict=True))
        fixed = self.options.bound_counts2
        inside = np.zeros(mse.shape, dtype=bool) if fixed is None else mse <= fixed
        evaluated = GridResult(grid, mse, scale, slack, inside, at_best)
        return conclude(
            around.model(problem), peak, draws, evaluated, kept=kept, dead=dead, law=law, bend=bend,
            box=self.box, options=self.options, rng=self.rng,
        )  # fmt: skip

    def _spread(self, function: Callable[..., Any], arguments: Iterable[Sequence[Any]]) -> Iterable[Any]:
        """Results of a function for some arguments, spread by the mapper."""
        return self.mapper(call, [partial(function, *some) for some in arguments])

    def _on_grid(
        self, problem: FitProblem, grid: MacroGrid, settings: MicroSettings, done: dict[int, GridSlab]
    ) -> list[GridSlab]:
        """The turns of the grid, those that are not done evaluated and kept."""
        turns = len(grid.alpha_rad)
        missing = [t for t in range(turns) if t not in done]
        self.progress("grid", turns - len(missing), turns)
        found = self._spread(evaluate_slab, [(problem, grid, t, settings) for t in missing])
        for turn, slab in zip(missing, found, strict=True):
            done[turn] = slab
            if self.store is not None:
                self.store.keep(turn, slab)
            self.progress("grid", len(done), turns)
        return [done[t] for t in range(turns)]

    def _climb_all(self, problem: FitProblem, bounds: Bounds, starts: Iterable[Floats]) -> list[Peak]:
        """Peaks of climbs from afar on kernels, the one with most posterior mass under it first (Laplace)."""
        peaks = self._spread(climb_near, [(problem, bounds, start) for start in starts])
        return sorted(peaks, key=lambda peak: -peak.log_evidence)

    def _refine(
        self, problem: FitProblem, starts: list[Floats]
    ) -> tuple[FitProblem, Bools, Bools, Peak, Neighbourhood]:
        """The highest peak, after glitches and dead taxels have been left out.

        Returns:
            Problem, kept presses, dead taxels, peak, and where images are tabled round it.
        """
        self.progress("peak", 0, 2)
        weak = weak_taxels(problem)
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
        peak, around = self._tabled(strong, peak)
        # What follows goes not far from here, one climb after the other.
        self.meanwhile()
        dead = dead_taxels(problem, peak.states)
        if dead.any():
            problem = problem.without_taxels(dead)
        if (dead ^ weak).any():
            peak = climb_near(problem, self.bounds, peak.macro, around)
        self.progress("peak", 1, 2)
        lost = lost_readings(problem, peak.states, float(peak.sigmas[4]))
        if lost.any():
            # How much gains differ is told by a climb from near by only; a weak taxel has not dropped out.
            without = climb_near(problem.without_readings(lost), self.bounds, peak.macro, around, peak.sigmas)
            lost = lost_readings(problem, peak.states, float(without.sigmas[4]))
            problem = problem.without_readings(lost)
            peak = climb_near(problem, self.bounds, without.macro, around)
        keep = ~glitches(problem, peak)
        if not keep.all():
            problem = problem.subset(keep, "glitch: its image or force does not fit with the other presses")
            again: list[tuple[Any, ...]] = [(problem, self.bounds, peak.macro, around)]
            if not general:  # a table goes no further than the peak that it was made for
                again.append((problem, self.bounds, starts[0], None))
            peak = max(self._spread(climb_near, again), key=lambda one: one.log_evidence)
        for _ in range(POLISH):
            problem = problem.with_signal(peak.states.simulated).with_shared(peak.theta)
            peak = climb_near(problem, self.bounds, peak.macro, around, peak.sigmas)
        if not around.holds(peak.macro):
            peak, around = self._tabled(problem, peak)
        self.progress("peak", 2, 2)
        return problem.with_shared(peak.theta), keep, dead, peak, around

    def _local_peaks(self, problem: FitProblem, starts: list[Floats]) -> list[Floats]:
        """Where climbs on the surface that looks the same everywhere end: the best, and one nearly as good."""
        assert problem.contacts is not None
        local = problem.contacts.on_grid
        if local is None:
            return starts
        # The centre may leave the box a little; what follows keeps to it.
        peaks = self._climb_all(local.problem(problem), local.bounds(self.bounds), map(local.arcs, starts))
        reach = np.array([ROUGH.centre_m, ROUGH.centre_m, ROUGH.alpha_rad, ROUGH.log_ratio, np.inf])
        found: list[Floats] = []
        for peak in peaks:
            macro = np.clip(local.labels(peak.macro), self.bounds.low, self.bounds.high)
            near = peaks[0].log_evidence - peak.log_evidence < RIVAL
            if near and all((np.abs(macro - other) > 0.5 * reach).any() for other in found):
                found.append(macro)
        return found[:RIVALS]

    def _table(self, problem: FitProblem, macro: Floats, reach: TableReach) -> SkinTable:
        """A table of images, made part by part but for those that an earlier run has made."""
        arguments = [(problem, presses, macro, reach) for presses in parts_of(problem)]
        names = [name_of(*some) for some in arguments]
        parts = [None if self.store is None else self.store.table(name) for name in names]
        missing = [n for n, part in enumerate(parts) if part is None]
        done = len(names) - len(missing)
        self.progress("images", done, len(names))
        made = self._spread(run_table, [arguments[n] for n in missing])
        for n, part in zip(missing, made, strict=True):
            parts[n], done = part, done + 1
            if self.store is not None:
                self.store.keep_table(names[n], part)
            self.progress("images", done, len(names))
        return joined([part for part in parts if part is not None])

    def _tabled(self, problem: FitProblem, peak: Peak) -> tuple[Peak, Neighbourhood]:
        """Where images are tabled round a peak; in the general way, which tables them, the peak on that fine table."""
        if problem.contacts is None:
            return peak, Neighbourhood.around(peak.macro)
        around, tries = None, 0
        while around is None or (tries < TABLES and not around.holds(peak.macro)):
            around = Neighbourhood.around(peak.macro, self._table(problem, peak.macro, reach_of(peak)))
            peak, tries = climb_near(problem, self.bounds, peak.macro, around), tries + 1
        return peak, around

    def _drawn(
        self, problem: FitProblem, peak: Peak, around: Neighbourhood
    ) -> tuple[FitProblem, Peak, Draws]:
        """Draws round the peak, and the problem and the peak that they are of.

        Without noise the density of presses of one taxel is too rough to be drawn from; those presses are then left
        out.
        """
        draws, density = self._sample(problem, peak, around)
        worth, lone = min(WORTH, self.options.enough_draws), problem.lone
        if draws.effective < worth and lone.any() and (~lone).sum() >= FEW_PRESSES:
            problem = problem.subset(~lone, "1 active taxel, beside presses of more that tell far more")
            problem = replace(problem, min_active=COORDINATES)
            peak = climb_near(problem, self.bounds, peak.macro, around, peak.sigmas)
            problem = problem.with_shared(peak.theta)
            draws, density = self._sample(problem, peak, around)
        if draws.effective < worth:
            draws = max(draws, walk(density, draws, self.rng), key=lambda d: d.effective)
        return problem, peak, draws

    def _sample(self, problem: FitProblem, peak: Peak, around: Neighbourhood) -> tuple[Draws, Density]:
        fewest, most = self.options.rounds
        lone = bool(problem.lone.any())

        def halved(function: Callable[..., Floats], about: object, points: Floats) -> Floats:
            # A fixed division, so that results do not depend on the number of workers.
            parts = [(problem, around, peak.places, about, part) for part in np.array_split(points, 2)]
            return np.concatenate(list(self._spread(function, parts)))

        self.progress("draws", 0, fewest)
        return sample(
            peak,
            problem,
            lambda points: halved(density_at, self.bounds, points),
            self.rng,
            size=self.options.round_size,
            rounds=(fewest, min(most, ROUGH_ROUNDS * fewest) if lone else most),
            worth=self.options.enough_draws,
            lacking=lambda points: halved(lacking_at, points.mean(axis=0), points),
            checked=CHECKED if lone else SMOOTH,
            on_round=lambda done: self.progress("draws", min(done, fewest), fewest),
        )

    def _laws_and_bends(
        self, problem: FitProblem, peak: Peak, around: Neighbourhood
    ) -> tuple[LawSpread, Bend]:
        """How likely other contact laws are, and responses that bend; every climb begins anew at the peak."""
        spreads = self.options.law_spreads_m
        self.progress("contact law", 0, 1)

        wide = [
            (problem, self.bounds, peak.macro, replace(around, spread_m=spread), peak.sigmas)
            for spread in spreads[1:]
        ]
        bare: list[tuple[Any, ...]] = []
        local = None if problem.contacts is None else problem.contacts.local
        if wide and problem.contacts is None:
            bare = [(problem, self.bounds, peak.macro, replace(around, projected=False), peak.sigmas)]
        elif wide and local is not None:
            # Tables of the skin model have the projections in them. There taxels that feel the pressure itself are
            # compared by kernels, on the surface as it is round the sensor; without those they are not.
            start = local.arcs(peak.macro)
            plain = Neighbourhood.around(start)
            bare = [
                (local.problem(problem), local.bounds(self.bounds), start, law, peak.sigmas)
                for law in (plain, replace(plain, projected=False))
            ]
        tried = responses(problem)
        bent = [(with_response(problem, one), self.bounds, peak.macro, around, peak.sigmas) for one in tried]
        found: list[Peak] = list(self._spread(climb_near, [*wide, *bare, *bent]))
        self.progress("contact law", 1, 1)
        laws, bare_peaks = [peak, *found[: len(wide)]], found[len(wide) : len(wide) + len(bare)]
        bent_peaks = found[len(wide) + len(bare) :]
        # The first is straight. All others begin anew at the peak, too; none may win by the places that this
        # finds.
        laws[0] = max(peak, bent_peaks[0], key=lambda one: one.log_evidence)
        comparable = laws + (bare_peaks if len(bare) == 1 else [])
        # A worker has loaded what these need, to look for another order of the taxels.
        [bend] = self._spread(weigh_bends, [(problem, comparable, tried, bent_peaks)])
        [law] = self._spread(weigh_laws, [(np.array(spreads), laws)])
        if bare:
            law = law.with_bare(laws[0] if len(bare) == 1 else bare_peaks[0], bare_peaks[-1])
        return law, bend


def _starts(problem: FitProblem, grid: MacroGrid, slabs: Sequence[GridSlab]) -> list[Floats]:
    """The best grid points that are not neighbours of each other, as macro variables (5,)."""
    mse, scale, slack = (np.stack(arrays) for arrays in zip(*slabs, strict=True))
    # What is left at the best grid point is mostly what normalised images do not tell of the places of presses; it
    # serves as the noise here.
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
        if len(starts) == STARTS:
            break
    if not starts:
        raise FitError(
            "no combination of the grid gives an image at all; the sensor lies where nothing was pressed. Widen the "
            "ranges of [mount], or check that positions are in the fingertip frame"
        )
    return starts
