"""From the peak and the draws to the result of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from skincal.fitting.fit_findings import find
from skincal.fitting.fit_options import FitOptions, SearchBox
from skincal.fitting.grid import GridSlab, MacroGrid
from skincal.fitting.law import LawSpread
from skincal.fitting.places import best_of_each, starting_nuisance
from skincal.fitting.posterior import Peak
from skincal.fitting.presses import settle
from skincal.fitting.problem import FitProblem
from skincal.fitting.result import PARAMETERS, FitResult, GridResult, PressFit, Sigmas
from skincal.fitting.sampling import Draws
from skincal.fitting.seen import Images
from skincal.fitting.straight import Bend
from skincal.fitting.types import Bools, Floats
from skincal.fitting.valley import OPEN, POSE, at_one_place, choose, interval, valley_loss


@dataclass(frozen=True, eq=False)
class Evidence:
    """Findings of the stages after the grid.

    Attributes:
        problem: the presses and taxels that are left when glitches and dead taxels have been taken out.
        kept: (K,) which of the presses that went into the grid are left.
        dead: (J,) taxels left out.
        peak: the most probable point.
        images: simulated images round the peak.
        draws: from the posterior.
        law: what is not known of the contact law.
        bend: how far the response bends.
        grid_mse_counts2: the grid's loss at the best point, of all presses that went into the grid [counts²].
    """

    problem: FitProblem
    kept: Bools
    dead: Bools
    peak: Peak
    images: Images
    draws: Draws
    law: LawSpread
    bend: Bend
    grid_mse_counts2: float


def conclude(
    grid: MacroGrid,
    slabs: Sequence[GridSlab],
    found: Evidence,
    box: SearchBox,
    options: FitOptions,
    rng: np.random.Generator,
) -> FitResult:
    """Best point, valley, intervals, and what a person should know."""
    problem, images, peak = found.problem, found.images, found.peak
    centre = found.draws.mean
    macro, sigmas = centre[:5], np.exp(centre[5:])
    presses, mse = _press_fit(problem, images, macro, peak, sigmas)
    chosen = found.draws.resampled(rng, options.draws)
    fixed = options.bound_counts2
    bound = valley_loss(problem, images, peak.places, chosen, rng) if fixed is None else fixed
    losses = _grid_result(grid, slabs, fixed, found.grid_mse_counts2)
    if fixed is None:
        told = as_told(problem, chosen, rng)
        clouds = _clouds(told, found.law, problem.rig.force_scale_sigma, rng)
    else:
        clouds = [choose(losses, options.draws, rng)]
    rest, half = _rest(problem, level=options.level)
    level = options.level if fixed is None else 1.0
    best = np.array([*macro[:3], *np.exp(macro[3:])])
    result = FitResult(
        best=dict(zip(PARAMETERS, best.tolist(), strict=True)),
        intervals={
            name: interval(name, [c[:, i] for c in clouds], float(best[i]), box, level)
            for i, name in enumerate(PARAMETERS)
        },
        mse_counts2=mse,
        valley_mse_counts2=float(bound),
        bound="noise" if fixed is None else "fixed",
        draws=np.concatenate(clouds),
        sigmas=Sigmas(*sigmas.tolist()),
        law_spread_m=found.law.best_m,
        law_rise=found.law.rise,
        bend=found.bend,
        effective_draws=found.draws.effective,
        force_low=float(np.exp(np.quantile(chosen[:, 6], 0.025))),
        misfit_low=float(np.exp(np.quantile(chosen[:, 8], 0.025))),
        rest_counts=rest,
        rest_interval=(rest - half, rest + half),
        grid=losses,
        presses=presses,
        problem=problem,
        box=box,
        scale_per_taxel_per_n=best[4] * np.exp(problem.shared.log_gain) if options.per_taxel else None,
        dead_taxels=found.dead,
        findings=(),
    )
    if not result.told:
        result = replace(result, intervals=dict.fromkeys(PARAMETERS, OPEN))
    elif at_one_place(problem):
        result = replace(result, intervals={**result.intervals, **dict.fromkeys(POSE, OPEN)})
    return find(result, dropped=int((~found.kept).sum()))


def _grid_result(
    grid: MacroGrid, slabs: Sequence[GridSlab], fixed_counts2: float | None, at_best_counts2: float
) -> GridResult:
    losses = np.stack([s.mse_counts2 for s in slabs])
    scale = np.stack([s.scale_per_n for s in slabs])
    slack = np.stack([s.slack_rms_m for s in slabs])
    inside = np.zeros(losses.shape, dtype=bool) if fixed_counts2 is None else losses <= fixed_counts2
    return GridResult(grid, losses, scale, slack, inside, at_best_counts2)


def as_told(problem: FitProblem, draws: Floats, rng: np.random.Generator) -> Floats:
    """Draws (N, 11) with what presses leave open whatever they are: the mean gain, and which contacts the pose is of.

    Presses tell the scale times the mean gain (:meth:`skincal.fitting.shared.Shared.directions`); that of J taxels is
    off by sigma_g / sqrt(J). Where positions err smoothly, the pose that they tell is another for other contacts: at
    any force from half of the hold's to all of it, and where those of another sample of as many presses last othersly
    long (exponential times: a variance of 2 / K of the field's).
    """
    taxels, many = max(int(problem.alive.sum()), 1), len(draws)
    shared = problem.shared
    others = np.sqrt((shared.field.reshape(2, -1) ** 2).sum(axis=1) * 2 / len(problem))
    out = draws.copy()
    out[:, 4] -= np.exp(draws[:, 9]) / np.sqrt(taxels) * rng.standard_normal(many)
    out[:, 4] = np.clip(out[:, 4], *np.log(problem.scales))
    out[:, :2] += rng.random((many, 1)) * shared.half_force_m + others * rng.standard_normal((many, 2))
    return out


def _clouds(
    draws: Floats, law: LawSpread, force_scale_sigma: float, rng: np.random.Generator
) -> list[Floats]:
    """Values (N, 5) of the parameters: half of the draws by the foundation, half by laws that spread pressure.

    Were all forces 1 + e times what was measured, the same images would come from E (1 + e) and S / (1 + e).
    """
    half = len(draws) // 2
    laws = [draws[:half, :5].copy(), law.shifted(draws[half:, :5], rng)]
    if force_scale_sigma > 0:
        for cloud in laws:
            error = force_scale_sigma * rng.standard_normal(len(cloud))
            cloud += error[:, None] * np.array([0.0, 0.0, 0.0, 1.0, -1.0])
    return [np.concatenate([c[:, :3], np.exp(c[:, 3:])], axis=1) for c in laws]


def _rest(problem: FitProblem, level: float) -> tuple[float, float]:
    """Level at rest that all taxels share [counts], and half the width of its interval; 0 where it has been taken off.

    It is the mean over taxels that were seen at rest: their levels scatter, and each is known as its dark readings say.
    """
    model, known = problem.observation, problem.observed.level_known
    if problem.rig.readout.rest_subtracted or not known.any():
        return 0.0, 0.0
    low = (problem.rig.readout.value_min or 0.0) if model.link.clips else 0.0
    levels = (model.offset + problem.shared.level)[known] + low
    dark = np.maximum((~problem.lit & problem.used)[:, known].sum(axis=0), 1)
    own = float((model.noise_counts**2 / dark).mean())
    scatter = float(levels.var(ddof=1)) if len(levels) > 1 else 0.0
    half = float(ndtri((1 + level) / 2)) * np.sqrt((own + scatter) / len(levels))
    return float(levels.mean()), half


def _press_fit(
    problem: FitProblem, images: Images, macro: Floats, peak: Peak, sigmas: Floats
) -> tuple[PressFit, float]:
    """The presses at the best point with the force taken as measured, and the loss there."""
    count = len(peak.places.press)
    many = np.broadcast_to(macro, (count, 5)).copy()
    start = starting_nuisance(problem, peak.places, many, peak.places.press, 1)
    start[:, 2] = 0.0
    stiff = np.broadcast_to(sigmas, (count, len(sigmas))).copy()
    stiff[:, 1] = 1e-7
    state = settle(problem, images, many, stiff, peak.places.press, start, iterations=20, room=1.0)
    best = best_of_each(peak.places.press, state.objective, len(problem))
    model, presses = problem.observation, np.arange(len(problem))
    many = np.ones(len(problem))
    spread = np.sqrt(model.variance(sigmas[2] * many, sigmas[3] * many, presses))
    squares = ((state.residual[best] * spread) ** 2).sum(axis=1)
    read = np.maximum((problem.used).sum(axis=1), 1)
    rmse = np.sqrt(squares / read)
    expected = np.sqrt((spread**2 * problem.used).sum(axis=1) / read)
    good = rmse <= 3.0 * np.maximum(float(np.median(rmse / expected)), 1.0) * expected
    fit = PressFit(
        state.nuisance[best][:, :2],
        state.uv_m[best],
        problem.values.copy(),
        state.simulated[best],
        rmse,
        good,
        peak.states.nuisance[:, 2],
    )
    return fit, float(squares.sum() / read.sum())
