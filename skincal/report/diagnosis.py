"""The report of a diagnosis: JSON for programs, and one self-contained page with its figures as files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import escape

from skincal.diagnosis.next_presses import PLAN_FILE
from skincal.effects import EFFECTS
from skincal.files import real
from skincal.report.audit import audit_figure
from skincal.report.diagnosis_figures import candidates_figure, curves_figure, gap_figure, where_figure
from skincal.report.diagnosis_words import tone
from skincal.report.page import picture, span, write_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from skincal.dataset import Dataset
    from skincal.diagnosis.diagnosis import Diagnosis

SUMMARY = "diagnosis.json"
FIGURES: Mapping[str, Callable[[Diagnosis, Dataset], Figure]] = {
    "gap": gap_figure,
    "signature": curves_figure,
    "where": where_figure,
    "candidates": candidates_figure,
}
"""Figures of the page, by the name of their file."""


def write_diagnosis_report(
    found: Diagnosis, dataset: Dataset, folder: Path, content: Mapping[str, Any], *, pages: bool = True
) -> None:
    """Write ``diagnosis.json``, and ``report.html`` with its figures, next to a calibration."""
    (folder / SUMMARY).write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if not pages:
        return
    unit, held, session = dataset.meta.sensor.unit, found.observed.held, found.observed.session
    write_page(
        "diagnosis.html",
        folder,
        dataset,
        found.calibration,
        # A calibration that is written unchanged still has the name of the dataset that it was fitted to.
        name=escape(real(dataset.folder).name if dataset.folder else "dataset"),
        found=found,
        known=EFFECTS,
        tone=tone(found),
        findings=sorted(found.findings, key=lambda finding: finding.severity != "warning"),
        parameters=_parameters(found),
        effects=_effects(found),
        plan=PLAN_FILE if found.next_plan is not None else "",
        presses=len(np.unique(session.press[session.press >= 0])),
        held=int(held.sum()),
        laws=list(dict.fromkeys(found.found.null.laws)),
        figures=[picture(draw(found, dataset), stem, folder, unit) for stem, draw in FIGURES.items()],
        last=picture(audit_figure(found.audit), "audit", folder),
    )


def _parameters(found: Diagnosis) -> list[tuple[object, ...]]:
    """Return effect, name, description, value, interval and refitted value of each parameter that was fitted."""
    rows: list[tuple[object, ...]] = []
    for effect in found.effects:
        final = next((c.parameters for c in found.calibration.effects if c.name == effect.name), {})
        for name, (low, high) in effect.intervals.items():
            value = effect.parameters[name]
            several = np.ndim(value) > 0
            interval = "one per value" if several else f"{span(low)} to {span(high)}"
            last = "" if several or name not in final else span(final[name])
            parameter = EFFECTS[effect.name].parameter(name)
            rows.append((effect.name, name, parameter, span(value), interval, last))
    return rows


def _effects(found: Diagnosis) -> list[tuple[str, ...]]:
    """Return name, visible strength, gain, kind and outcome of all known effects."""
    first = {t.name: t for t in found.found.rounds[0]} if found.found.rounds else {}
    named = {e.name for e in found.effects}
    rows: list[tuple[str, ...]] = []
    for name in EFFECTS:
        smallest, candidate = found.audit.effects[name].smallest_strength, first.get(name)
        rival = next((e.name for e in found.effects if name in e.consistent_with[1:]), "")
        kind, outcome = "no", "no evidence"
        if name in named:
            kind, outcome = "named", "named and added"
        elif rival:
            kind, outcome = "rival", f"cannot be distinguished from {rival}"
        elif name in found.audit.cannot_see:
            kind, outcome = "blind", f"not visible: {found.audit.reasons.get(name, '')}"
        elif candidate is not None and candidate.passes_null:
            outcome = "improves the fit, but others explain more"
        visible = f"{smallest:.2g}" if np.isfinite(smallest) else "never"
        gain = "" if candidate is None else f"{candidate.gain:.1f} of {candidate.limit:.1f}"
        rows.append((name, visible, gain, kind, outcome))
    return rows
