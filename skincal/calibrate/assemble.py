"""Convert the result of a fit to a calibration: the names, units and tables of the files."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.calibrate.data_findings import adapt_to_rig
from skincal.calibration import Calibration, Finding, Interval, Loss, ModelParameters, Provenance
from skincal.calibration.parts import REST
from skincal.dataset import Dataset
from skincal.fitting.problem import USED
from skincal.fitting.result import PARAMETERS, FitResult
from skincal.units import deg
from skincal.version import __version__

Columns = dict[str, NDArray[Any]]


def make_provenance(dataset: Dataset, command: str, seed: int, options: Mapping[str, Any]) -> Provenance:
    """Return the provenance of a fit that runs now."""
    return Provenance(
        dataset_sha256=dataset.sha256 or "",
        dataset="" if dataset.folder is None else dataset.folder.name,
        version=__version__,
        command=command,
        seed=seed,
        time=datetime.now(UTC).replace(microsecond=0),
        options=options,
    )


def calibration_of(result: FitResult, dataset: Dataset, provenance: Provenance) -> Calibration:
    """Return the calibration of a dataset from the result of its fit."""
    names, factors = _file_units(result)
    best = {names[n]: v * factors[n] for n, v in result.best.items()}
    intervals: dict[str, Interval] = {
        names[n]: (low * factors[n], high * factors[n]) for n, (low, high) in result.intervals.items()
    }
    intervals[REST] = result.rest_interval
    per_taxel = result.scale_per_taxel_per_n
    return Calibration.of_dataset(
        dataset,
        model=ModelParameters(
            **best,
            scale_per_taxel_per_n=None if per_taxel is None else tuple(per_taxel.tolist()),
            rest_counts=result.rest_counts,
        ),
        intervals=intervals,
        loss=_build_loss(result),
        provenance=provenance,
        findings=adapt_to_rig(
            tuple(Finding(f.code, f.severity, f.text, f.advice) for f in result.findings), dataset
        ),
        draws={names[n]: result.draws[:, i] * factors[n] for i, n in enumerate(PARAMETERS)},
        grid=_grid_columns(result, names, factors),
        slack=_slack_columns(result, dataset),
    )


def _file_units(result: FitResult) -> tuple[dict[str, str], dict[str, float]]:
    """Return the file names of the fit's parameters, and the factors from the fit's units to those of the files."""
    radius = result.problem.rig.arc_radius_m
    names = {n: n for n in PARAMETERS} | {"alpha_rad": "alpha_deg", "across_m": "x_m"}
    factors = dict.fromkeys(PARAMETERS, 1.0) | {"alpha_rad": deg(1.0)}
    if radius is not None:
        names["across_m"] = "beta_deg"
        factors["across_m"] = deg(1.0 / radius)
    return names, factors


def _build_loss(result: FitResult) -> Loss:
    """Return the loss, with further figures of the fit."""
    return Loss(
        result.mse_counts2,
        result.valley_mse_counts2,
        len(result.problem),
        extra={
            "valley_bound": result.bound,
            "presses_dropped": len(result.problem.status) - len(result.problem),
            "position_sigma_m": result.sigmas.position_m,
            "force_sigma_relative": result.sigmas.force,
            "noise_sigma_counts": result.sigmas.noise_counts,
            "misfit_relative": result.sigmas.misfit,
            "gain_sigma_relative": result.sigmas.gain,
            "position_field_m": result.sigmas.field_m,
            "contact_law_spread_m": result.law_spread_m,
            "effective_draws": result.effective_draws,
        },
    )


def _grid_columns(result: FitResult, names: dict[str, str], factors: dict[str, float]) -> Columns:
    """Return the evaluated grid as a table, one row per combination."""
    evaluated = result.grid
    grid = evaluated.grid
    axes = np.meshgrid(grid.alpha_rad, np.exp(grid.log_elasticity), grid.across_m, grid.y_m, indexing="ij")
    columns: Columns = {
        names[n]: a.ravel() * factors[n]
        for n, a in zip(("alpha_rad", "elasticity_pa_per_m", "across_m", "y_m"), axes, strict=True)
    }
    columns |= {
        "scale_per_n": evaluated.scale_per_n.ravel(),
        "mse_counts2": evaluated.mse_counts2.ravel(),
        "slack_rms_m": evaluated.slack_rms_m.ravel(),
    }
    if result.bound == "fixed":  # a valley that the noise bounds is not made of combinations
        columns["in_valley"] = evaluated.in_valley.ravel().astype(np.int64)
    return columns


def _slack_columns(result: FitResult, dataset: Dataset) -> Columns:
    """Return the slack table, one row per press of the session; NaN for presses that were not used."""
    problem, presses = result.problem, result.presses
    count = len(problem.status)
    used = np.array([status == USED for status in problem.status])

    def column(values: NDArray[Any], fill: Any = np.nan) -> NDArray[Any]:
        out = np.full(count, fill, dtype=values.dtype)
        out[problem.rows] = values
        return out

    slack, measured = presses.slack_m, dataset.presses.position_m[problem.rows]
    points = problem.rig.surface.offset(measured, slack[:, 0], slack[:, 1])
    return {
        "press": np.asarray(dataset.presses.press),
        "used": used,
        "reason": np.array(["" if s == USED else s for s in problem.status], dtype=object),
        "active_taxels": problem.active.astype(np.int64),
        **{name: column(at) for name, at in zip(("x_m", "y_m", "z_m"), points.T, strict=True)},
        "slack_across_m": column(slack[:, 0]),
        "slack_along_m": column(slack[:, 1]),
        "residual_rms_counts": column(presses.rmse_counts),
        "good": column(presses.good, fill=False),
    }
