"""Update a calibration from a joint fit: parameters, intervals and draws of base model and effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.calibration import Calibration, Effect, Finding, Interval, ModelParameters
from skincal.calibration.calibration import Columns, effect_from
from skincal.calibration.parts import LAW, REST, FittedLaw, Loss, code_of
from skincal.dataset import Dataset, active_taxels
from skincal.diagnosis.diagnosis import SENTENCES
from skincal.diagnosis.observed import Observed
from skincal.files import real
from skincal.fitting.fit_options import FitOptions
from skincal.inference.columns import with_values
from skincal.inference.constants import WIDTH
from skincal.inference.contact_law import law_ends
from skincal.inference.fit import NB, Fitted, Fitter
from skincal.inference.forward import Forward, State
from skincal.model.arrays import FloatArray, IntArray
from skincal.units import deg
from skincal.version import __version__

OUTLIER, UNKNOWN = "looks like a glitch", "no known place or force, or nothing of its hold was read"
"""Reasons why a press was not used, as written in the table of presses."""
_DRAWS = 2000
_GOOD_RATIO, _GOOD_COUNTS = 3.0, 0.5
"""A press is well matched up to this multiple of the median residual, or up to this residual [counts]."""
LEVEL = FitOptions().level
"""Level of the intervals of base parameters, as in a fit."""
MISFIT = Finding(
    "misfit",
    "warning",
    f"In addition to the named effects {SENTENCES['unknown']}.",
    "The report and diagnosis.json next to this calibration say where.",
)


def updated_parameters(calibration: Calibration, state: State) -> ModelParameters:
    """Return the model parameters of a calibration, updated to a state."""
    old, scale = calibration.model, np.exp(state.log_s)
    common, per_taxel = float(np.median(scale)), old.scale_per_taxel_per_n
    if per_taxel is not None and scale.ndim:
        # The scale of dead taxels stays 0.
        old_scale = np.asarray(per_taxel)
        is_alive = old_scale > 0
        ratio = scale / np.where(is_alive, old_scale, 1.0)
        common = old.scale_per_n * float(np.median(ratio[is_alive]))
        per_taxel = tuple(np.where(is_alive, scale, 0.0).tolist())
    return replace(
        old,
        y_m=float(state.pose.y_m),
        alpha_deg=deg(state.pose.alpha_rad),
        elasticity_pa_per_m=float(np.exp(state.log_e)),
        scale_per_n=common,
        beta_deg=None if old.beta_deg is None else deg(state.pose.beta_rad),
        x_m=None if old.beta_deg is not None else float(state.pose.x_m),
        scale_per_taxel_per_n=per_taxel,
    )


def base_draws(
    fitter: Fitter, fit: Fitted, covariance: FloatArray, rng: np.random.Generator, count: int = _DRAWS
) -> dict[str, FloatArray]:
    """Return draws (count,) of each base parameter from the joint posterior, by the names of a calibration."""
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
    """Return the ends of the interval of each fitted parameter of an effect."""
    sd = np.sqrt(np.maximum(np.diag(covariance)[NB:], 0.0))
    effects = fit.state.effects
    best = np.array([f.get(effects) for f in fit.free])
    one, other = (with_values(effects, fit.free, best + side * WIDTH * sd)[name] for side in (-1.0, 1.0))
    keys = dict.fromkeys(f.parameter.name for f in fit.free if f.effect == name)  # keeps the order
    return {k: (np.minimum(one[k], other[k]), np.maximum(one[k], other[k])) for k in keys}


def contact_law_of(forward: Forward, fit: Fitted, covariance: FloatArray) -> FittedLaw:
    """Return the contact law of a fit with its intervals."""
    own, (low, high) = forward.contact_law(fit.state.law), law_ends(forward, fit.state.law, covariance)
    return FittedLaw(own, {k: (getattr(low, k), getattr(high, k)) for k in LAW})


def update_calibration(
    calibration: Calibration,
    observed: Observed,
    fit: Fitted,
    covariance: FloatArray,
    rng: np.random.Generator,
    outliers: IntArray,
    *,
    unexplained: bool,
    law: bool,
) -> Calibration:
    """Return a calibration updated from a joint fit.

    Args:
        calibration: the calibration to update.
        observed: the session.
        fit: fit of base model and effects to all presses.
        covariance: (n, n) its covariance (:func:`skincal.diagnosis.shared_errors.posterior_covariance`).
        rng: makes the draws.
        outliers: rows of presses that were left out of the fit.
        unexplained: whether a residual remains that no effect explains.
        law: whether the calibration gets the fitted contact law.
    """
    dataset, fitter = observed.dataset, observed.fitter
    drawn = base_draws(fitter, fit, covariance, rng)
    intervals: dict[str, Interval] = {
        k: (float(np.quantile(v, 0.5 - LEVEL / 2)), float(np.quantile(v, 0.5 + LEVEL / 2)))
        for k, v in drawn.items()
    }
    if REST in calibration.intervals:
        intervals[REST] = calibration.intervals[REST]
    model = updated_parameters(calibration, fit.state)
    old_names = {e.name for e in calibration.effects}
    fitted = {f.effect for f in fit.free}
    taxels = dataset.layout().taxels
    effects: list[Effect] = [e for e in calibration.effects if e.name not in fitted]
    effects += [
        effect_from(
            name, values, effect_intervals(fit, name, covariance), taxels=taxels, poses=observed.poses
        )
        for name, values in fit.state.effects.items()
        if name in fitted or name not in old_names
    ]
    loss, slack = _loss_and_press_table(calibration, observed, fit, outliers)
    findings = tuple(f for f in calibration.findings if not code_of(f.code).of_base_model)
    old, label = calibration.provenance, "" if dataset.folder is None else real(dataset.folder).name
    calibrated_on = {"calibrated_on": old.dataset, "calibrated_on_sha256": old.dataset_sha256}
    provenance = replace(
        old,
        dataset=label or old.dataset,
        dataset_sha256=dataset.sha256 or old.dataset_sha256,
        version=__version__,
        extra={**old.extra, **calibrated_on, "diagnosed": label},
    )
    return replace(
        calibration, model=model, intervals={k: v for k, v in intervals.items() if k in model.best()}, draws=drawn,
        effects=tuple(effects), contact_law=contact_law_of(fitter.forward, fit, covariance) if law else None,
        provenance=provenance, grid=None, folder=None, loss=loss, slack=slack,
        findings=(*findings, MISFIT) if unexplained else findings,
    )  # fmt: skip


def hold_residuals(observed: Observed, fit: Fitted) -> FloatArray:
    """Return the residuals (P, J) [counts] of the mean image of each hold; NaN where nothing was read."""
    forward, session = observed.fitter.forward, observed.session
    mean, _ = forward.noise.written(fit.prediction.values + fit.state.rest)
    assert session.counts is not None
    residual = session.counts - forward.mean @ mean
    of_holds = np.full((len(observed.dataset.presses), residual.shape[1]), np.nan)
    for p in np.unique(session.press[session.held()]).tolist():
        rows = session.held() & (session.press == p)
        of_holds[p] = np.average(residual[rows], axis=0, weights=session.frames[rows])
    return of_holds


def _loss_and_press_table(
    calibration: Calibration, observed: Observed, fit: Fitted, outliers: IntArray
) -> tuple[Loss, Columns]:
    """Return the loss of a fit, and the table of presses with contact positions, slack and residuals."""
    dataset: Dataset = observed.dataset
    residual = hold_residuals(observed, fit)
    count = len(residual)
    is_outlier = np.isin(np.arange(count), outliers)
    used = np.isfinite(residual).any(axis=1) & ~is_outlier
    old = calibration.loss
    mse = float(np.nanmean(residual[used] ** 2)) if used.any() else old.mse_counts2
    valley = mse + max(0.0, old.valley_mse_counts2 - old.mse_counts2)
    slack, points = np.full((count, 2), np.nan), np.full((count, 3), np.nan)
    measured = dataset.presses.position_m
    rows = np.flatnonzero(used)
    rows = rows[rows < len(fit.state.move)]
    slack[rows] = fit.state.move[rows, :2]
    rows = rows[np.isfinite(measured[rows]).all(axis=1)]
    points[rows] = dataset.surface().offset(measured[rows], slack[rows, 0], slack[rows, 1])
    rms = np.full(count, np.nan)
    rms[used] = np.sqrt(np.nanmean(residual[used] ** 2, axis=1))
    good = used & (rms <= max(_GOOD_RATIO * float(np.nanmedian(rms)), _GOOD_COUNTS)) if used.any() else used
    table: Columns = {
        "press": np.asarray(dataset.presses.press),
        "used": used,
        "reason": np.where(used, "", np.where(is_outlier, OUTLIER, UNKNOWN)).astype(object),
        "active_taxels": active_taxels(dataset).sum(axis=1).astype(np.int64),
        **{name: points[:, k] for k, name in enumerate(("x_m", "y_m", "z_m"))},
        "slack_across_m": slack[:, 0],
        "slack_along_m": slack[:, 1],
        "residual_rms_counts": rms,
        "good": good,
    }
    extra = old.extra
    if "presses_dropped" in extra:
        extra = {**extra, "presses_dropped": int((~used).sum())}
    return Loss(mse, valley, int(used.sum()), extra), table
