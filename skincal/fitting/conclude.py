"""Turn the peak and the draws into the result of a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from skincal.fitting.fit_findings import add_findings
from skincal.fitting.fit_options import FitOptions, SearchBox
from skincal.fitting.lattice import best_of_each
from skincal.fitting.law import LawSpread
from skincal.fitting.posterior import Peak
from skincal.fitting.presses import PressModel
from skincal.fitting.problem import FitProblem
from skincal.fitting.response import Nonlinearity
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
    nonlinearity: Nonlinearity,
    box: SearchBox,
    options: FitOptions,
    rng: np.random.Generator,
) -> FitResult:
    """Return the result: best point, valley, intervals and findings.

    Args:
        model: the presses and taxels without outliers and dead taxels, with tables around the peak.
        peak: the maximum of the posterior.
        draws: from the posterior.
        grid: the evaluated grid.
        kept: (K,) presses of the grid that were kept.
        dead: (J,) taxels left out.
        law: uncertainty of the contact law.
        nonlinearity: of the response.
        box: ranges that were searched.
        options: settings.
        rng: only source of randomness.
    """
    problem, centre = model.problem, draws.mean
    macro, sigmas = centre[:5], np.exp(centre[5:])
    presses, mse = _fit_presses(model, macro, peak, sigmas)
    chosen = draws.resampled(rng, options.draws)
    fixed = options.bound_counts2
    if fixed is None:
        bound, level = valley_loss(model, peak.places, chosen, rng), options.level
        clouds = _mix_laws(add_unseen_errors(problem, chosen, rng), law, problem.rig.force_scale_sigma, rng)
    else:
        bound, level = fixed, 1.0
        clouds = [choose(grid, options.draws, rng)]
    rest, half = _estimate_rest(problem, level=options.level)
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
        nonlinearity=nonlinearity,
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
    if not result.gives_intervals:
        result = replace(result, intervals=dict.fromkeys(PARAMETERS, OPEN))
    elif at_one_place(problem):
        result = replace(result, intervals={**intervals, **dict.fromkeys(POSE, OPEN)})
    return add_findings(result, dropped=int((~kept).sum()))


def add_unseen_errors(problem: FitProblem, draws: Floats, rng: np.random.Generator) -> Floats:
    """Return draws (N, 11) with the errors that presses can never show: the mean gain, and the mean position error.

    Presses determine the scale times the mean gain (:meth:`skincal.fitting.shared.Shared.directions`); the
    mean of J gains has a standard deviation of sigma_g / sqrt(J). If positions err smoothly, the pose depends
    on the contacts that define it. The draws vary their force from half of the hold's to all of it. They also
    vary the sample: another sample of as many presses with other durations (exponential) has a mean error of
    variance 2 / K of the field's.
    """
    taxels, many = max(int(problem.alive.sum()), 1), len(draws)
    shared = problem.shared
    others = np.sqrt((shared.field.reshape(2, -1) ** 2).sum(axis=1) * 2 / len(problem))
    out = draws.copy()
    out[:, 4] -= np.exp(draws[:, 9]) / np.sqrt(taxels) * rng.standard_normal(many)
    out[:, 4] = np.clip(out[:, 4], *np.log(problem.scales))
    out[:, :2] += rng.random((many, 1)) * shared.half_force_m + others * rng.standard_normal((many, 2))
    return out


def _mix_laws(
    draws: Floats, law: LawSpread, force_scale_sigma: float, rng: np.random.Generator
) -> list[Floats]:
    """Return values (N, 5) of the parameters: half of the draws by the foundation, half by laws that spread pressure.

    If all forces were 1 + e times the measured ones, the same images would come from E (1 + e) and S / (1 +
    e). The declared scale error of the force is therefore added to the draws of log E, and subtracted from
    those of log S.
    """
    half = len(draws) // 2
    laws = [draws[:half, :5].copy(), law.shifted(draws[half:, :5], rng)]
    if force_scale_sigma > 0:
        for cloud in laws:
            error = force_scale_sigma * rng.standard_normal(len(cloud))
            cloud += error[:, None] * np.array([0.0, 0.0, 0.0, 1.0, -1.0])
    return [np.concatenate([c[:, :3], np.exp(c[:, 3:])], axis=1) for c in laws]


def _estimate_rest(problem: FitProblem, level: float) -> tuple[float, float]:
    """Return the rest level that all taxels share [counts], and half the width of its interval; 0 if it was subtracted.

    It is the mean over taxels that were seen at rest. Its variance includes the scatter of the levels, and
    the noise of the dark readings.
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


def _fit_presses(model: PressModel, macro: Floats, peak: Peak, sigmas: Floats) -> tuple[PressFit, float]:
    """Return the presses at the best point with the forces as measured, and the loss there."""
    problem = model.problem
    every = model.fit_at_places(
        peak.places, macro[None], sigmas[None], forces_known=True, iterations=20, slack_factor=1.0
    )
    state = every.take(best_of_each(every.press, every.objective, len(problem)))
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
