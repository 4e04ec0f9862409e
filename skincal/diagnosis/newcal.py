"""A calibration with effects: best parameters, intervals and draws of base and effects, all of one joint posterior."""

from __future__ import annotations

from dataclasses import replace
from math import degrees

import numpy as np

from skincal.calibration import Calibration, Effect, Finding, Interval, ModelParameters
from skincal.calibration.calibration import Columns
from skincal.calibration.finding_codes import code_of
from skincal.calibration.parts import LAW, REST, FittedLaw, Loss
from skincal.calibration.skin import effect_from
from skincal.dataset import Dataset, active_taxels
from skincal.diagnosis.observed import Observed
from skincal.files import real
from skincal.fitting.fit_options import FitOptions
from skincal.inference.columns import with_values
from skincal.inference.contact_law import law_ends
from skincal.inference.fit import NB, Fitted, Fitter
from skincal.inference.forward import Forward, State
from skincal.model.arrays import FloatArray, IntArray
from skincal.version import __version__

GLITCH, UNKNOWN = "looks like a glitch", "no known place or force, or nothing of its hold was read"
"""Why a press was not used."""
_WIDTH, _DRAWS = 1.96, 2000
LEVEL = FitOptions().level
"""What intervals of the base are worth: as much as those of a fit."""
LEFT = Finding(
    "misfit",
    "warning",
    "Beside the effects that were named something is missing that none of the known ones explains.",
    "The page and diagnosis.json beside this calibration say where.",
)


def parameters_of(calibration: Calibration, state: State) -> ModelParameters:
    """The best parameters of a calibration as a state has them."""
    old, scale = calibration.model, np.exp(state.log_s)
    each = None if old.scale_per_taxel_per_n is None else np.asarray(old.scale_per_taxel_per_n)
    common, own = float(np.median(scale)), old.scale_per_taxel_per_n
    if each is not None and scale.ndim:
        # Taxels of scale 0 do not answer, and stay so.
        ratio = scale / np.where(each > 0, each, 1.0)
        common = old.scale_per_n * float(np.median(ratio[each > 0]))
        own = tuple(np.where(each > 0, scale, 0.0).tolist())
    return replace(
        old,
        y_m=float(state.pose.y_m),
        alpha_deg=degrees(state.pose.alpha_rad),
        elasticity_pa_per_m=float(np.exp(state.log_e)),
        scale_per_n=common,
        beta_deg=None if old.beta_deg is None else degrees(state.pose.beta_rad),
        x_m=None if old.beta_deg is not None else float(state.pose.x_m),
        scale_per_taxel_per_n=own,
    )


def base_draws(
    fitter: Fitter, fit: Fitted, covariance: FloatArray, rng: np.random.Generator, count: int = _DRAWS
) -> dict[str, FloatArray]:
    """Draws of the base's parameters from the joint posterior, by the names of a calibration."""
    drawn = rng.multivariate_normal(np.zeros(5), covariance[:5, :5], count, method="eigh")
    s, radius = fit.state, fitter.turning_radius(fit.state)
    turn = (
        {"x_m": s.pose.x_m + drawn[:, 1]}
        if radius == 0
        else {"beta_deg": np.degrees(s.pose.beta_rad + drawn[:, 1] / radius)}
    )
    return {
        "y_m": s.pose.y_m + drawn[:, 0],
        **turn,
        "alpha_deg": np.degrees(s.pose.alpha_rad + drawn[:, 2]),
        "elasticity_pa_per_m": np.exp(s.log_e + drawn[:, 3]),
        "scale_per_n": np.exp(float(np.median(s.log_s)) + drawn[:, 4]),
    }


def effect_intervals(
    fit: Fitted, name: str, covariance: FloatArray
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Low and high, 95 %, of what was fitted of an effect."""
    sd = np.sqrt(np.maximum(np.diag(covariance)[NB:], 0.0))
    own = fit.state.effects
    at = np.array([f.get(own) for f in fit.free])
    ends = [with_values(own, fit.free, at + side * _WIDTH * sd) for side in (-1.0, 1.0)]
    keys = dict.fromkeys(f.parameter.name for f in fit.free if f.effect == name)  # in their order
    return {
        k: (np.minimum(ends[0][name][k], ends[1][name][k]), np.maximum(ends[0][name][k], ends[1][name][k]))
        for k in keys
    }


def fitted_law(forward: Forward, fit: Fitted, covariance: FloatArray) -> FittedLaw:
    """The contact law of a fit, with intervals, 95 %."""
    own, (low, high) = forward.contact_law(fit.state.law), law_ends(forward, fit.state.law, covariance)
    return FittedLaw(own, {k: (getattr(low, k), getattr(high, k)) for k in LAW})


def new_calibration(
    calibration: Calibration,
    observed: Observed,
    fit: Fitted,
    covariance: FloatArray,
    rng: np.random.Generator,
    wild: IntArray,
    *,
    unexplained: bool,
    law: bool,
) -> Calibration:
    """The calibration that a joint fit comes to.

    Args:
        calibration: that it comes from.
        observed: the session.
        fit: of base and effects to all presses.
        covariance: of its numbers (:func:`skincal.diagnosis.shared_errors.covariance`).
        rng: of the draws.
        wild: rows of presses that were left out, as their images are out of all proportion.
        unexplained: whether something is left that no effect explains.
        law: whether the calibration gets the contact law that was fitted.
    """
    dataset, fitter = observed.dataset, observed.fitter
    drawn = base_draws(fitter, fit, covariance, rng)
    intervals: dict[str, Interval] = {
        k: (float(np.quantile(v, 0.5 - LEVEL / 2)), float(np.quantile(v, 0.5 + LEVEL / 2)))
        for k, v in drawn.items()
    }
    if REST in calibration.intervals:
        intervals[REST] = calibration.intervals[REST]
    model = parameters_of(calibration, fit.state)
    had = {e.name for e in calibration.effects}
    fitted = {f.effect for f in fit.free}
    effects: list[Effect] = [e for e in calibration.effects if e.name not in fitted]
    for name, values in fit.state.effects.items():
        if name in fitted or name not in had:
            taxels = dataset.layout().taxels
            effects.append(
                effect_from(
                    name, values, effect_intervals(fit, name, covariance), taxels=taxels, poses=observed.poses
                )
            )
    loss, slack = _fitted_presses(calibration, observed, fit, wild)
    findings = tuple(one for one in calibration.findings if not code_of(one.code).of_base_model)
    from_, label = calibration.provenance, "" if dataset.folder is None else real(dataset.folder).name
    before = {"calibrated_on": from_.dataset, "calibrated_on_sha256": from_.dataset_sha256}
    provenance = replace(
        from_,
        dataset=label or from_.dataset,
        dataset_sha256=dataset.sha256 or from_.dataset_sha256,
        version=__version__,
        extra={**from_.extra, **before, "diagnosed": label},
    )
    return replace(
        calibration, model=model, intervals={k: v for k, v in intervals.items() if k in model.best()}, draws=drawn,
        effects=tuple(effects), contact_law=fitted_law(observed.fitter.forward, fit, covariance) if law else None,
        provenance=provenance, grid=None, folder=None, loss=loss, slack=slack,
        findings=(*findings, LEFT) if unexplained else findings,
    )  # fmt: skip


def hold_residuals(observed: Observed, fit: Fitted) -> FloatArray:
    """(P, J) what is left of the mean image of each hold [counts]; NaN where nothing was read."""
    f, s = observed.fitter.forward, observed.session
    mean, _ = f.noise.written(fit.prediction.values + fit.state.rest)
    assert s.counts is not None
    left = s.counts - f.mean @ mean
    out = np.full((len(observed.dataset.presses), left.shape[1]), np.nan)
    for p in np.unique(s.press[s.held()]).tolist():
        rows = s.held() & (s.press == p)
        out[p] = np.average(left[rows], axis=0, weights=s.frames[rows])
    return out


def _fitted_presses(
    calibration: Calibration, observed: Observed, fit: Fitted, wild: IntArray
) -> tuple[Loss, Columns]:
    dataset: Dataset = observed.dataset
    left = hold_residuals(observed, fit)
    count = len(left)
    used = np.isfinite(left).any(axis=1) & ~np.isin(np.arange(count), wild)
    old = calibration.loss
    mse = float(np.nanmean(left[used] ** 2)) if used.any() else old.mse_counts2
    valley = mse + max(0.0, old.valley_mse_counts2 - old.mse_counts2)
    slack, points, measured = (
        np.full((count, 2), np.nan),
        np.full((count, 3), np.nan),
        dataset.presses.position_m,
    )
    rows = np.flatnonzero(used)
    rows = rows[rows < len(fit.state.move)]
    slack[rows] = fit.state.move[rows, :2]
    rows = rows[np.isfinite(measured[rows]).all(axis=1)]
    points[rows] = dataset.surface().offset(measured[rows], slack[rows, 0], slack[rows, 1])
    rms = np.full(count, np.nan)
    rms[used] = np.sqrt(np.nanmean(left[used] ** 2, axis=1))
    good = used & (rms <= max(3 * float(np.nanmedian(rms)), 0.5)) if used.any() else used
    table: Columns = {
        "press": np.asarray(dataset.presses.press),
        "used": used,
        "reason": np.where(used, "", np.where(np.isin(np.arange(count), wild), GLITCH, UNKNOWN)).astype(
            object
        ),
        "active_taxels": active_taxels(dataset).sum(axis=1).astype(np.int64),
        **{name: points[:, k] for k, name in enumerate(("x_m", "y_m", "z_m"))},
        "slack_across_m": slack[:, 0],
        "slack_along_m": slack[:, 1],
        "residual_rms_counts": rms,
        "good": good,
    }
    return Loss(
        mse,
        valley,
        int(used.sum()),
        {**old.extra, "presses_dropped": int((~used).sum())} if "presses_dropped" in old.extra else old.extra,
    ), table
