"""From the peak and the draws to the result of a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from skincal.fitting.fit_findings import find
from skincal.fitting.fit_options import FitOptions, SearchBox
from skincal.fitting.lattice import best_of_each
from skincal.fitting.law import LawSpread
from skincal.fitting.posterior import Peak
from skincal.fitting.presses import PressModel
from skincal.fitting.problem import FitProblem
from skincal.fitting.response import Bend
from skincal.fitting.result import PARAMETERS, FitResult, GridResult, PressFit, Sigmas
from skincal.fitting.sampling import Draws
from skincal.fitting.types import Bools, Floats
from skincal.fitting.valley import OPEN, POSE, at_one_place, choose, interval, valley_loss


def conclude(
    model: PressModel,
    peak: Peak,
    draws: Draws,
    grid: GridResult,
    *,
    kept: Bools,
    dead: Bools,
    law: LawSpread,
    bend: Bend,
    box: SearchBox,
    options: FitOptions,
    rng: np.random.Generator,
) -> FitResult:
    """Best point, valley, intervals, and what a person should know.

    Args:
        model: the presses and taxels that are left when glitches and dead taxels have been taken out, with simulated
            images round the peak.
        peak: the most probable point.
        draws: from the posterior.
        grid: the evaluated grid.
        kept: (K,) which of the presses that went into the grid are left.
        dead: (J,) taxels left out.
        law: what is not known of the contact law.
        bend: how far the response bends.
        box: ranges that were searched.
        options: settings.
        rng: the only source of chance.
    """
    problem, centre = model.problem, draws.mean
    macro, sigmas = centre[:5], np.exp(centre[5:])
    presses, mse = _press_fit(model, macro, peak, sigmas)
    chosen = draws.resampled(rng, options.draws)
    fixed = options.bound_counts2
    if fixed is None:
        bound, level = valley_loss(model, peak.places, chosen, rng), options.level
        clouds = _clouds(as_told(problem, chosen, rng), law, problem.rig.force_scale_sigma, rng)
    else:
        bound, level = fixed, 1.0
        clouds = [choose(grid, options.draws, rng)]
    rest, half = _rest(problem, level=options.level)
    best = np.array([*macro[:3], *np.exp(macro[3:])])
    intervals = {
        name: interval(name, [c[:, i] for c in clouds], float(best[i]), box, level)
        for i, name in enumerate(PARAMETERS)
    }
    result = FitResult(
        best=dict(zip(PARAMETERS, best.tolist(), strict=True)),
        intervals=intervals,
        mse_counts2=mse,
        valley_mse_counts2=float(bound),
        bound="noise" if fixed is None else "fixed",
        draws=np.concatenate(clouds),
        sigmas=Sigmas(*sigmas.tolist()),
        law_spread_m=law.best_m,
        law_rise=law.rise,
        bend=bend,
        effective_draws=draws.effective,
        force_low=float(np.exp(np.quantile(chosen[:, 6], 0.025))),
        misfit_low=float(np.exp(np.quantile(chosen[:, 8], 0.025))),
        rest_counts=rest,
        rest_interval=(rest - half, rest + half),
        grid=grid,
        presses=presses,
        problem=problem,
        box=box,
        scale_per_taxel_per_n=best[4] * np.exp(problem.shared.log_gain) if options.per_taxel else None,
        dead_taxels=dead,
        findings=(),
    )
    if not result.told:
        result = replace(result, intervals=dict.fromkeys(PARAMETERS, OPEN))
    elif at_one_place(problem):
        result = replace(result, intervals={**intervals, **dict.fromkeys(POSE, OPEN)})
    return find(result, dropped=int((~kept).sum()))


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


def _press_fit(model: PressModel, macro: Floats, peak: Peak, sigmas: Floats) -> tuple[PressFit, float]:
    """The presses at the best point with the force taken as measured, and the loss there."""
    problem = model.problem
    every = model.settle_at(
        peak.places, macro[None], sigmas[None], forces_known=True, iterations=20, room=1.0
    )
    state = every.some(best_of_each(every.press, every.objective, len(problem)))
    spread = np.sqrt(problem.observation.variance(state.sigmas[:, 2], state.sigmas[:, 3], state.press))
    squares = ((state.residual * spread) ** 2).sum(axis=1)
    read = np.maximum((problem.used).sum(axis=1), 1)
    rmse = np.sqrt(squares / read)
    expected = np.sqrt((spread**2 * problem.used).sum(axis=1) / read)
    good = rmse <= 3.0 * np.maximum(float(np.median(rmse / expected)), 1.0) * expected
    fit = PressFit(
        state.nuisance[:, :2],
        state.uv_m,
        problem.values.copy(),
        state.simulated,
        rmse,
        good,
        peak.states.nuisance[:, 2],
    )
    return fit, float(squares.sum() / read.sum())
