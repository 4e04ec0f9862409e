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
from skincal.inference.constants import LEVEL
from skincal.report.cards import tone
from skincal.report.diagnosis_figures import (
    audit_figure,
    candidates_figure,
    curves_figure,
    gap_figure,
    where_figure,
)
from skincal.report.page import Picture, percent, picture, span, write_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from skincal.dataset import Dataset
    from skincal.diagnosis.diagnosis import Diagnosis
    from skincal.fitting.tasks import Mapper

SUMMARY = "diagnosis.json"
FIGURES: Mapping[str, Callable[[Diagnosis, Dataset], Figure]] = {
    "gap": gap_figure,
    "signature": curves_figure,
    "where": where_figure,
    "candidates": candidates_figure,
}
"""Figures of the page, by the name of their file."""


def write_diagnosis_report(
    diagnosis: Diagnosis,
    dataset: Dataset,
    folder: Path,
    content: Mapping[str, Any],
    *,
    pages: bool = True,
    mapper: Mapper = map,
) -> None:
    """Write ``diagnosis.json`` with some content, and ``report.html`` with its figures, next to a calibration.

    ``pages`` is false to leave out the page; ``mapper`` draws figures in parallel.
    """
    (folder / SUMMARY).write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if not pages:
        return
    observed, session = diagnosis.observed, diagnosis.observed.session
    drawn = mapper(_draw, [(stem, diagnosis, dataset, folder) for stem in (*FIGURES, "audit")])
    *figures, last = drawn
    write_page(
        "diagnosis.html",
        folder,
        dataset,
        diagnosis.calibration,
        # An unchanged calibration still has the name of the dataset that it was fitted to.
        name=escape(real(dataset.folder).name if dataset.folder else "dataset"),
        diagnosis=diagnosis,
        known=EFFECTS,
        tone=tone(diagnosis),
        findings=sorted(diagnosis.findings, key=lambda finding: finding.severity != "warning"),
        parameters=_parameters(diagnosis),
        effects=_effects(diagnosis),
        plan=PLAN_FILE if diagnosis.next_plan is not None else "",
        presses=len(np.unique(session.press[session.press >= 0])),
        held=int(observed.is_test.sum()),
        laws=list(dict.fromkeys(diagnosis.found.null.laws)),
        figures=figures,
        last=last,
        level=percent(LEVEL),
    )


def _draw(asked: tuple[str, Diagnosis, Dataset, Path]) -> Picture:
    stem, diagnosis, dataset, folder = asked
    if stem == "audit":
        return picture(audit_figure(diagnosis.audit), stem, folder)
    return picture(FIGURES[stem](diagnosis, dataset), stem, folder, dataset.meta.sensor.unit)


def _parameters(diagnosis: Diagnosis) -> list[tuple[object, ...]]:
    """Return effect, name, description, value, interval and refitted value of each parameter that was fitted."""
    rows: list[tuple[object, ...]] = []
    for effect in diagnosis.effects:
        final = next((c.parameters for c in diagnosis.calibration.effects if c.name == effect.name), {})
        for name, (low, high) in effect.intervals.items():
            value = effect.parameters[name]
            is_array = np.ndim(value) > 0
            interval = "one per value" if is_array else f"{span(low)} to {span(high)}"
            last = "" if is_array or name not in final else span(final[name])
            parameter = EFFECTS[effect.name].parameter(name)
            rows.append((effect.name, name, parameter, span(value), interval, last))
    return rows


def _effects(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """Return name, visible strength, gain, kind and outcome of all known effects."""
    candidates = {c.name: c for c in diagnosis.found.rounds[0]} if diagnosis.found.rounds else {}
    named = {e.name for e in diagnosis.effects}
    rows: list[tuple[str, ...]] = []
    for name in EFFECTS:
        smallest, candidate = diagnosis.audit.effects[name].smallest_strength, candidates.get(name)
        rival = next((e.name for e in diagnosis.effects if name in e.consistent_with[1:]), "")
        kind, outcome = "no", "no evidence"
        if name in named:
            kind, outcome = "named", "named and added"
        elif rival:
            kind, outcome = "rival", f"cannot be distinguished from {rival}"
        elif name in diagnosis.audit.cannot_see:
            kind, outcome = "blind", f"not visible: {diagnosis.audit.reasons.get(name, '')}"
        elif candidate is not None and candidate.passes_null:
            outcome = "improves the fit, but others explain more"
        elif candidate is not None and candidate.gain > candidate.limit:
            outcome = "no evidence: only a few presses gain by it"
        visible = f"{smallest:.2g}" if np.isfinite(smallest) else "never"
        gain = "" if candidate is None else f"{candidate.gain:.1f} of {candidate.limit:.1f}"
        rows.append((name, visible, gain, kind, outcome))
    return rows
