"""Warnings about a well-formed dataset."""

from __future__ import annotations

import numpy as np

from skincal.covariates import NORMAL
from skincal.dataset.columns import repeated
from skincal.dataset.count_checks import named
from skincal.dataset.dataset import Dataset
from skincal.dataset.findings import Findings, Sheet
from skincal.dataset.rest import ACTIVE_COUNTS, REST_IN_DOUBT, active_taxels, active_threshold, rest_in_doubt

SLACK_SIGMAS = 50.0
"""Largest plausible slack, in sigmas: beyond it, one of the two is probably in another unit."""

FEWEST_ACTIVE = 1e-3
"""With a threshold set by noise, active taxels in fewer readings than this are noise."""

STUCK_SHARE = 0.9
"""A taxel that reads value_max in more than this share of the presses is reported as stuck."""


def add_remarks(dataset: Dataset, sheet: Sheet, findings: Findings) -> None:
    """Add warnings to the findings."""
    _remark_on_activity(dataset, sheet, findings)
    _remark_on_stuck(dataset, sheet, findings)
    _remark_on_repeats(dataset, sheet)
    _remark_on_normals(dataset, sheet)
    _remark_on_slack(dataset, findings)
    force = dataset.presses.force_n
    sheet.bad_rows("force_n", force <= 0, force, "a positive normal force", "An outlier?", warning=True)


def _remark_on_activity(dataset: Dataset, sheet: Sheet, findings: Findings) -> None:
    threshold = active_threshold(dataset)
    active = active_taxels(dataset, threshold)
    # Noise alone makes a taxel active now and then.
    if threshold < ACTIVE_COUNTS and active.mean() < FEWEST_ACTIVE:
        active[:] = False
    expected = f"taxels more than {threshold:.3g} {dataset.meta.sensor.unit_label} above their level at rest"
    if not active.any():
        why = f"{REST_IN_DOUBT}." if rest_in_doubt(dataset) else "Do the counts grow with load?"
        fix = f"Nothing can be fitted to such data. {why}"
        findings.warn(sheet.file, expected, "none in any press", fix, code="nothing_to_fit")
    elif not np.any(active.sum(axis=1) >= 2):
        findings.warn(
            sheet.file, f"two {expected} in a press", "at most one in any press", "The fit needs two."
        )


def _remark_on_slack(dataset: Dataset, findings: Findings) -> None:
    """Warn where slack_m and sigma_m do not fit together: no press is off by more than its slack, or by many sigmas."""
    position = dataset.meta.position
    if 0 < position.sigma_m < position.slack_m / SLACK_SIGMAS:
        findings.warn(
            "dataset.toml, [position] sigma_m",
            f"a good part of slack_m = {position.slack_m:g}",
            f"{position.sigma_m:g}",
            "Twice sigma_m is a usual slack. Are both in metres?",
        )
    if np.isfinite(position.sigma_m) and position.slack_m < position.sigma_m:
        findings.warn(
            "dataset.toml, [position] slack_m",
            f"more than sigma_m = {position.sigma_m:g}",
            f"{position.slack_m:g}",
            "Twice sigma_m is usual. Are both in metres?",
        )


def _remark_on_stuck(dataset: Dataset, sheet: Sheet, findings: Findings) -> None:
    top = dataset.meta.sensor.value_max
    if top is None or dataset.meta.sensor.baseline != "raw":
        return
    stuck = np.flatnonzero(np.mean(dataset.presses.counts >= top, axis=0) > STUCK_SHARE)
    if stuck.size:
        names = named(list(dataset.meta.sensor.taxel_columns()), stuck)
        findings.warn(
            sheet.file, f"counts below value_max = {top:g}", f"nearly always {top:g} from {names}", "Stuck?"
        )


def _remark_on_repeats(dataset: Dataset, sheet: Sheet) -> None:
    """Warn of one measurement under two numbers: noise would have made two measurements differ."""
    presses = dataset.presses
    values = np.column_stack([presses.position_m, presses.force_n, presses.counts])
    fix = "Was a press copied? A fit uses one of them."
    sheet.bad_rows("press", repeated(values), presses.press, "different measurements", fix, warning=True)


def _remark_on_normals(dataset: Dataset, sheet: Sheet) -> None:
    presses = dataset.presses
    if presses.normals is None or not np.isfinite(presses.position_m).all():
        return
    cosine = np.sum(presses.normals * dataset.surface().normal_at(presses.position_m), axis=1)
    expected = "a normal out of the fingertip (positive cosine with the surface's)"
    fix = "Is it the direction of the force instead?"
    sheet.bad_rows(", ".join(NORMAL), cosine < 0, cosine, expected, fix, warning=True)
