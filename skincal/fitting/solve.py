"""The fit, stage by stage: grid, peak, contact law, draws, valley."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skincal.fitting.conclude import Evidence, conclude
from skincal.fitting.errors import FitError
from skincal.fitting.fit_options import STEPS, FitOptions, GridSteps, SearchBox
from skincal.fitting.general_table import ROUGH, SkinTable, TableReach
from skincal.fitting.general_tabling import (
    NO_STORE,
    TableStore,
    joined,
    name_of,
    reach_of,
    run_table,
    table_tasks,
)
from skincal.fitting.grid import GridSlab, MacroGrid, span
from skincal.fitting.law import LawSpread, weigh_laws
from skincal.fitting.micro import MicroSettings
from skincal.fitting.posterior import Bounds, Peak
from skincal.fitting.problem import COORDINATES, FEW_PRESSES, FitProblem
from skincal.fitting.result import FitResult
from skincal.fitting.robust import dead_taxels, glitches, lost_readings, weak_taxels
from skincal.fitting.sampling import Density, Draws, Lacking, sample, walk
from skincal.fitting.straight import BENDS, Bend, straightened, weigh_bends
from skincal.fitting.tasks import (
    ClimbTask,
    DensityTask,
    EvidenceTask,
    Mapper,
    Neighbourhood,
    SlabTask,
    run_climb,
    run_density,
    run_evidence,
    run_slab,
)
from skincal.fitting.types import Floats

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
"""Draws at which it is found what the log posterior misses, :func:`skincal.fitting.tasks.run_evidence`: with presses of
one taxel, where it is rough, and without."""

POLISH = 2
"""Times that a peak is climbed anew with the noise of readings as simulated images have it, and with shared errors."""
RIVAL, RIVALS = 30.0, 2
"""Peaks of the local surface within so much log evidence of its best are looked at by the skin model, the best few."""

TABLES = 3
"""A peak of the general way that leaves the table it was climbed on is tabled anew so many times at most."""

Progress = Callable[[str, int, int], None]
"""Told the stage, how much of it is done, and of how much."""


def _silent(_stage: str, _done: int, _total: int) -> None:
    return


@dataclass(frozen=True, eq=False)
class FitPlan:
    """The evaluation of the grid; the same plan gives the same slabs.

    Attributes:
        problem: presses that are used.
        on_grid: those of them that the grid places by their normalised images.
        grid: macro variables.
        settings: of the micro problems.
    """

    problem: FitProblem
    on_grid: FitProblem
    grid: MacroGrid
    settings: MicroSettings


def default_steps(problem: FitProblem) -> GridSteps:
    """Steps of the macro grid that the way of the fit affords."""
    if problem.contacts is None:
        return STEPS["fast"]
    return STEPS["nlopt" if problem.contacts.local is None else "general"]


def plan_fit(problem: FitProblem, box: SearchBox, options: FitOptions) -> FitPlan:
    """Lays out the macro grid and the micro settings.

    Raises:
        FitError: no press can be used, or fewer than the parameters need.
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
    sigma = max(GRID_NOISE * problem.observation.typical_counts, problem.noise_sigma_counts)
    return FitPlan(
        problem,
        problem.on_grid,
        grid,
        MicroSettings(sigma, problem.rig.position_sigma_m, problem.rig.slack_m),
    )


def solve(
    plan: FitPlan,
    box: SearchBox,
    options: FitOptions,
    rng: np.random.Generator,
    *,
    mapper: Mapper = map,
    slabs: Mapping[int, GridSlab] | None = None,
    on_slab: Callable[[int, GridSlab], None] = lambda _turn, _slab: None,
    tables: TableStore = NO_STORE,
    progress: Progress = _silent,
) -> FitResult:
    """Fits.

    Args:
        plan: grid and presses, from :func:`plan_fit`.
        box: ranges to search.
        options: settings.
        rng: the only source of chance.
        mapper: spreads independent work; the result does not depend on it.
        slabs: turns of the grid that have been evaluated before.
        on_slab: told of every turn as it is done, so that it can be kept.
        tables: keeps tables of images, of which the general way spends its time.
        progress: told how far the work is.

    Returns:
        Best point, intervals, grid, draws, and what a person should know.
    """
    done = _run_grid(plan, mapper, dict(slabs or {}), on_slab, progress)
    bounds = _bounds(box, plan.problem.scales)
    problem, kept, dead, peak, around = _refine(
        plan, done, bounds, _Tabler(mapper, tables, progress), progress
    )
    problem, peak, draws = _drawn(problem, peak, around, bounds, options, rng, mapper, progress)
    images = around.images(problem)
    law, bend = _weigh_laws_and_bends(problem, peak, around, bounds, options, mapper, progress)
    at_best = _grid_loss(plan, draws.mean)
    found = Evidence(problem, kept, dead, peak, images, draws, law, bend, at_best)
    slabs_in_order = [done[t] for t in range(len(plan.grid.alpha_rad))]
    return conclude(plan.grid, slabs_in_order, found, box, options, rng)


def _bounds(box: SearchBox, scales: tuple[float, float]) -> Bounds:
    low, high = np.array([box.across_m, box.y_m, box.alpha_rad]).T
    log_e, log_s = np.log(box.elasticity_pa_per_m), np.log(scales)
    return Bounds(np.array([*low, log_e[0], log_s[0]]), np.array([*high, log_e[1], log_s[1]]))


def _run_grid(
    plan: FitPlan,
    mapper: Mapper,
    done: dict[int, GridSlab],
    on_slab: Callable[[int, GridSlab], None],
    progress: Progress,
) -> dict[int, GridSlab]:
    turns = len(plan.grid.alpha_rad)
    missing = [t for t in range(turns) if t not in done]
    progress("grid", turns - len(missing), turns)
    tasks = [SlabTask(plan.on_grid, plan.grid, t, plan.settings) for t in missing]
    for turn, slab in zip(missing, mapper(run_slab, tasks), strict=True):
        done[turn] = slab
        on_slab(turn, slab)
        progress("grid", len(done), turns)
    return done


def _grid_loss(plan: FitPlan, macro: Floats) -> float:
    """The grid's loss [counts²] at macro variables (5,) that are none of its values."""
    across, along, alpha, log_e = macro[:4, None]
    slab = run_slab(SlabTask(plan.on_grid, MacroGrid(across, along, alpha, log_e), 0, plan.settings))
    return float(slab.mse_counts2[0, 0, 0])


def _starts(plan: FitPlan, done: Mapping[int, GridSlab], most: int = 4) -> list[Floats]:
    """The best grid points that are not neighbours of each other, as macro variables (5,)."""
    grid, problem = plan.grid, plan.on_grid
    mse = np.stack([done[t].mse_counts2 for t in range(len(grid.alpha_rad))])
    scale = np.stack([done[t].scale_per_n for t in range(len(grid.alpha_rad))])
    slack = np.stack([done[t].slack_rms_m for t in range(len(grid.alpha_rad))])
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
        if len(starts) == most:
            break
    if not starts:
        raise FitError(
            "no combination of the grid gives an image at all; the sensor lies where nothing was pressed. Widen the "
            "ranges of [mount], or check that positions are in the fingertip frame"
        )
    return starts


def _refine(
    plan: FitPlan, done: Mapping[int, GridSlab], bounds: Bounds, tabler: _Tabler, progress: Progress
) -> tuple[FitProblem, NDArray[np.bool_], NDArray[np.bool_], Peak, Neighbourhood]:
    """The highest peak, after glitches and dead taxels have been left out.

    Returns:
        Problem, kept presses, dead taxels, peak, and where images are tabled round it.
    """
    problem, mapper = plan.problem, tabler.mapper
    starts = _starts(plan, done)
    progress("peak", 0, 2)
    weak = weak_taxels(problem)
    strong = problem.without_taxels(weak) if weak.any() else problem
    table = None
    if problem.contacts is None:
        peak = _highest(mapper(run_climb, [ClimbTask(strong, bounds, s) for s in starts]))
    else:
        starts = _local_peaks(strong, bounds, starts, mapper)
        peak = _highest(_climb_tabled(strong, bounds, s, tabler) for s in starts)
        peak, table = _tabled(strong, bounds, peak, tabler)
    # What follows goes not far from here.
    around = Neighbourhood.around(peak.macro, table)
    dead = dead_taxels(problem, peak.states)
    if dead.any():
        problem = problem.without_taxels(dead)
    if (dead ^ weak).any():
        peak = run_climb(ClimbTask(problem, bounds, peak.macro, around))
    progress("peak", 1, 2)
    lost = lost_readings(problem, peak.states, float(peak.sigmas[4]))
    if lost.any():
        # How much gains differ is told by a climb from near by only; a weak taxel has not dropped out.
        without = run_climb(
            ClimbTask(problem.without_readings(lost), bounds, peak.macro, around, peak.sigmas)
        )
        lost = lost_readings(problem, peak.states, float(without.sigmas[4]))
        problem = problem.without_readings(lost)
        peak = run_climb(ClimbTask(problem, bounds, without.macro, around))
    keep = ~glitches(problem, peak)
    if not keep.all():
        problem = problem.subset(keep, "glitch: its image or force does not fit with the other presses")
        again = [ClimbTask(problem, bounds, peak.macro, around)]
        if table is None:  # a table goes no further than the peak that it was made for
            again.append(ClimbTask(problem, bounds, starts[0]))
        peak = _highest(mapper(run_climb, again))
    for _ in range(POLISH):
        problem = problem.with_signal(peak.states.simulated).with_shared(peak.theta)
        peak = run_climb(ClimbTask(problem, bounds, peak.macro, around, peak.sigmas))
    if not (around.holds(peak.macro) if table is None else table.holds(peak.macro)):
        if table is not None:
            peak, table = _tabled(problem, bounds, peak, tabler)
        around = Neighbourhood.around(peak.macro, table)
    progress("peak", 2, 2)
    return problem.with_shared(peak.theta), keep, dead, peak, around


@dataclass(frozen=True, eq=False)
class _Tabler:
    """Makes tables of images part by part, and takes those that an earlier run has made."""

    mapper: Mapper
    store: TableStore
    progress: Progress

    def __call__(self, problem: FitProblem, macro: Floats, reach: TableReach) -> SkinTable:
        tasks = table_tasks(problem, macro, reach)
        names = [name_of(task) for task in tasks]
        parts = [self.store.table(name) for name in names]
        missing = [n for n, part in enumerate(parts) if part is None]
        done = len(tasks) - len(missing)
        self.progress("images", done, len(tasks))
        for n, part in zip(missing, self.mapper(run_table, [tasks[n] for n in missing]), strict=True):
            parts[n] = part
            self.store.keep_table(names[n], part)
            done += 1
            self.progress("images", done, len(tasks))
        return joined([part for part in parts if part is not None])


def _climb_tabled(problem: FitProblem, bounds: Bounds, start: Floats, tabler: _Tabler) -> Peak:
    """A climb from a point of the grid, on a table as rough as the grid."""
    around = Neighbourhood.around(start, tabler(problem, start, ROUGH))
    return run_climb(ClimbTask(problem, bounds, start, around))


def _local_peaks(problem: FitProblem, bounds: Bounds, starts: list[Floats], mapper: Mapper) -> list[Floats]:
    """Return where climbs on the surface that looks the same everywhere end: the best, and one nearly as good."""
    assert problem.contacts is not None
    local = problem.contacts.local
    if local is None:
        return starts
    # The centre may leave the box a little; what follows keeps to it.
    box = Bounds(*(local.arcs(end) for end in (bounds.low, bounds.high)))
    tasks = [ClimbTask(local.problem(problem), box, local.arcs(start)) for start in starts]
    peaks: list[Peak] = sorted(mapper(run_climb, tasks), key=lambda p: -p.log_evidence)
    found: list[Floats] = []
    for peak in peaks:
        macro = np.clip(local.labels(peak.macro), bounds.low, bounds.high)
        near = peaks[0].log_evidence - peak.log_evidence < RIVAL
        reach = np.array([ROUGH.centre_m, ROUGH.centre_m, ROUGH.alpha_rad, ROUGH.log_ratio, np.inf])
        if near and all((np.abs(macro - other) > 0.5 * reach).any() for other in found):
            found.append(macro)
    return found[:RIVALS]


def _tabled(problem: FitProblem, bounds: Bounds, peak: Peak, tabler: _Tabler) -> tuple[Peak, SkinTable]:
    """In the general way, the peak on a fine table of images round it, and that table."""
    table, tries = None, 0
    while table is None or (tries < TABLES and not table.holds(peak.macro)):
        table = tabler(problem, peak.macro, reach_of(peak))
        around = Neighbourhood.around(peak.macro, table)
        peak, tries = run_climb(ClimbTask(problem, bounds, peak.macro, around)), tries + 1
    return peak, table


def _highest(peaks: object) -> Peak:
    """The peak with most posterior mass under it (Laplace)."""
    found: list[Peak] = list(peaks)  # type: ignore[call-overload]
    return max(found, key=lambda p: p.log_evidence)


def _drawn(
    problem: FitProblem,
    peak: Peak,
    around: Neighbourhood,
    bounds: Bounds,
    options: FitOptions,
    rng: np.random.Generator,
    mapper: Mapper,
    progress: Progress,
) -> tuple[FitProblem, Peak, Draws]:
    """Draws round the peak, and the problem and the peak that they are of.

    Without noise the density of presses of one taxel is too rough to be drawn from; those presses are then left out.
    """
    draws, density = _sample(problem, peak, around, bounds, options, rng, mapper, progress)
    worth = min(WORTH, options.enough_draws)
    lone = problem.lone
    if draws.effective < worth and lone.any() and (~lone).sum() >= FEW_PRESSES:
        problem = problem.subset(~lone, "1 active taxel, beside presses of more that tell far more")
        problem = replace(problem, min_active=COORDINATES)
        peak = run_climb(ClimbTask(problem, bounds, peak.macro, around, peak.sigmas))
        problem = problem.with_shared(peak.theta)
        draws, density = _sample(problem, peak, around, bounds, options, rng, mapper, progress)
    if draws.effective < worth:
        draws = max(draws, walk(density, draws, rng), key=lambda d: d.effective)
    return problem, peak, draws


def _sample(
    problem: FitProblem,
    peak: Peak,
    around: Neighbourhood,
    bounds: Bounds,
    options: FitOptions,
    rng: np.random.Generator,
    mapper: Mapper,
    progress: Progress,
) -> tuple[Draws, Density]:
    fewest, most = options.rounds
    lone = bool(problem.lone.any())

    # A fixed division, so that results do not depend on the number of workers.
    def density(points: Floats) -> Floats:
        parts = [DensityTask(problem, around, peak.places, bounds, p) for p in np.array_split(points, 2)]
        return np.concatenate(list(mapper(run_density, parts)))

    def lacking(points: Floats) -> Floats:
        middle = points.mean(axis=0)
        parts = [EvidenceTask(problem, around, peak.places, middle, p) for p in np.array_split(points, 2)]
        return np.concatenate(list(mapper(run_evidence, parts)))

    progress("draws", 0, fewest)
    return sample(
        peak,
        problem,
        density,
        rng,
        size=options.round_size,
        rounds=(fewest, min(most, ROUGH_ROUNDS * fewest) if lone else most),
        worth=options.enough_draws,
        lacking=Lacking(lacking, CHECKED if lone else SMOOTH),
        on_round=lambda done: progress("draws", min(done, fewest), fewest),
    )


def _weigh_laws_and_bends(
    problem: FitProblem,
    peak: Peak,
    around: Neighbourhood,
    bounds: Bounds,
    options: FitOptions,
    mapper: Mapper,
    progress: Progress,
) -> tuple[LawSpread, Bend]:
    spreads = options.law_spreads_m
    progress("contact law", 0, 1)
    wide = [
        ClimbTask(problem, bounds, peak.macro, replace(around, spread_m=spread), peak.sigmas)
        for spread in spreads[1:]
    ]
    bare = _bare_tasks(problem, peak, around, bounds) if wide else []
    straight = [straightened(problem, *bend) for bend in BENDS]
    lines = [ClimbTask(one, bounds, peak.macro, around, peak.sigmas) for one, _ in straight]
    peaks = [peak, *mapper(run_climb, [*wide, *bare, *lines])]
    progress("contact law", 1, 1)
    peaks, straight_peaks = peaks[: -len(lines)], peaks[-len(lines) :]
    # The first straightens nothing. All others begin anew at the peak, too; none may win by the places that this finds.
    if straight_peaks[0].log_evidence > peak.log_evidence:
        peak = peaks[0] = straight_peaks[0]
    comparable = peaks if len(bare) == 1 else peaks[: len(spreads)]
    bend = weigh_bends(comparable, straight_peaks, [jacobian for _, jacobian in straight])
    law = weigh_laws(np.array(spreads), peaks[: len(spreads)])
    if bare:
        law = law.with_bare(peak if len(bare) == 1 else peaks[-2], peaks[-1])
    return law, bend


def _bare_tasks(problem: FitProblem, peak: Peak, around: Neighbourhood, bounds: Bounds) -> list[ClimbTask]:
    """Climbs with taxels that feel the pressure itself, the last one, and with what it is compared with before it.

    Tables of the skin model have the projections in them. There both climbs are by kernels, on the surface as it is
    round the sensor; without those there is none.
    """
    laws = [replace(around, projected=False)]
    macro = peak.macro
    if problem.contacts is not None:
        local = problem.contacts.local
        if local is None:
            return []
        problem, macro = local.problem(problem), local.arcs(macro)
        bounds = Bounds(*(local.arcs(end) for end in (bounds.low, bounds.high)))
        plain = Neighbourhood.around(macro)
        laws = [plain, replace(plain, projected=False)]
    return [ClimbTask(problem, bounds, macro, law, peak.sigmas) for law in laws]
