"""Turn the peak and the draws into the result of a fit.

The valley holds the combinations that the data cannot tell from the best one; intervals bound it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from skincal.fitting.alternatives import LawSpread, Nonlinearity
from skincal.fitting.fit_findings import add_findings
from skincal.fitting.fit_options import FitOptions, SearchBox
from skincal.fitting.lattice import best_of_each
from skincal.fitting.posterior import Peak
from skincal.fitting.presses import Places, PressModel
from skincal.fitting.problem import FitProblem
from skincal.fitting.result import (
    OPEN,
    PARAMETERS,
    POSE,
    FitResult,
    GridResult,
    PressFit,
    Sigmas,
    at_one_place,
)
from skincal.fitting.sampling import Draws
from skincal.fitting.shared import PER_FORCE_ERROR
from skincal.fitting.types import Bools, Floats

UNBOUNDED_FROM = 0.9
"""A parameter whose interval fills this fraction of the searched range is not identified."""


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

    ``model`` has no outliers and dead taxels, and tables around the peak; ``kept`` (K,) are the presses that were
    kept, ``dead`` (J,) the taxels left out.
    """
    problem, centre = model.problem, draws.mean
    macro, sigmas = centre[:5], np.exp(centre[5:])
    presses, mse = _fit_presses(model, macro, peak, sigmas)
    chosen = draws.resampled(rng, options.draws)
    fixed = options.bound_counts2
    if fixed is None:
        bound, level = valley_loss(model, peak.places, chosen, rng, options.level), options.level
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
            cloud[:, 3:] += error[:, None] * PER_FORCE_ERROR
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


def valley_loss(
    model: PressModel, places: Places, points: Floats, rng: np.random.Generator, level: float
) -> float:
    """Return the loss [counts²] that a part ``level`` of draws (N, 11) stays below: the valley's bound by the noise.

    Some of the draws are evaluated, at random.
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
    return float(np.quantile(total / max(float((problem.weight > 0).sum()), 1.0), level))


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
