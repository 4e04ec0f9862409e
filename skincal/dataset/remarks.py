"""Warnings about a well-formed dataset."""

from __future__ import annotations

import numpy as np

from skincal.covariates import NORMAL
from skincal.dataset.columns import repeated
from skincal.dataset.dataset import Dataset
from skincal.dataset.findings import Findings, Sheet
from skincal.dataset.rest import ACTIVE_COUNTS, REST_IN_DOUBT, active_taxels, active_threshold, rest_in_doubt
from skincal.errors import first_of

SLACK_SIGMAS = 50.0
"""Largest plausible slack, in sigmas: above it, one of the two is probably in another unit."""

FEWEST_ACTIVE = 1e-3
"""Smallest fraction of active readings that noise does not explain, if noise sets the threshold."""

STUCK_SHARE = 0.9
"""Largest fraction of presses at value_max; above it a taxel is reported as stuck."""


def add_remarks(dataset: Dataset, sheet: Sheet) -> None:
    """Add warnings to the findings of the sheet of presses."""
    _remark_on_activity(dataset, sheet)
    _remark_on_stuck(dataset, sheet)
    presses = dataset.presses
    # Noise makes two separate measurements differ.
    values = np.column_stack([presses.position_m, presses.force_n, presses.counts])
    fix = "Was a press copied? A fit uses one of them."
    sheet.bad_rows("press", repeated(values), presses.press, "different measurements", fix, warning=True)
    _remark_on_normals(dataset, sheet)
    _remark_on_slack(dataset, sheet.findings)
    force = presses.force_n
    sheet.bad_rows("force_n", force <= 0, force, "a positive normal force", "An outlier?", warning=True)


def _remark_on_activity(dataset: Dataset, sheet: Sheet) -> None:
    """Warn if no press has the two active taxels that a fit needs."""
    threshold = active_threshold(dataset)
    active = active_taxels(dataset, threshold)
    # Noise alone makes a taxel active occasionally.
    if threshold < ACTIVE_COUNTS and active.mean() < FEWEST_ACTIVE:
        active[:] = False
    expected = f"taxels more than {threshold:.3g} {dataset.meta.sensor.unit_label} above their level at rest"
    if not active.any():
        why = f"{REST_IN_DOUBT}." if rest_in_doubt(dataset) else "Do the counts grow with load?"
        fix = f"Nothing can be fitted to such data. {why}"
        sheet.findings.warn(sheet.file, expected, "none in any press", fix, code="nothing_to_fit")
    elif not np.any(active.sum(axis=1) >= 2):
        got, expected = "at most one in any press", f"two {expected} in a press"
        sheet.findings.warn(sheet.file, expected, got, "The fit needs two.")


def _remark_on_slack(dataset: Dataset, findings: Findings) -> None:
    """Warn if slack_m and sigma_m are inconsistent: the slack should be a few sigmas."""
    sigma, slack = dataset.meta.position.sigma_m, dataset.meta.position.slack_m
    place, fix = "dataset.toml, [position]", "Twice sigma_m is a usual slack. Are both in metres?"
    if 0 < sigma < slack / SLACK_SIGMAS:
        findings.warn(f"{place} sigma_m", f"a good part of slack_m = {slack:g}", f"{sigma:g}", fix)
    if np.isfinite(sigma) and slack < sigma:
        findings.warn(f"{place} slack_m", f"more than sigma_m = {sigma:g}", f"{slack:g}", fix)


def _remark_on_stuck(dataset: Dataset, sheet: Sheet) -> None:
    """Warn about taxels that are nearly always at value_max."""
    top = dataset.meta.sensor.value_max
    if top is None or dataset.meta.sensor.baseline != "raw":
        return
    stuck = np.flatnonzero(np.mean(dataset.presses.counts >= top, axis=0) > STUCK_SHARE)
    if stuck.size:
        names = dataset.meta.sensor.taxel_columns()
        got = f"nearly always {top:g} from {first_of((names[j] for j in stuck), 6)}"
        sheet.findings.warn(sheet.file, f"counts below value_max = {top:g}", got, "Stuck?")


def _remark_on_normals(dataset: Dataset, sheet: Sheet) -> None:
    """Warn about measured normals that point into the fingertip."""
    presses = dataset.presses
    if presses.normals is None or not np.isfinite(presses.position_m).all():
        return
    cosine = np.sum(presses.normals * dataset.surface().normal_at(presses.position_m), axis=1)
    expected = "a normal out of the fingertip (positive cosine with the surface's)"
    fix = "Is it the direction of the force instead?"
    sheet.bad_rows(", ".join(NORMAL), cosine < 0, cosine, expected, fix, warning=True)
