"""The report of a diagnosis: what other programs read, one page that holds everything, and its pictures beside it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from skincal.diagnose.next_presses import PLAN_FILE
from skincal.report.audit import audit_figure
from skincal.report.diagnosis_candidates import candidates_figure, critical_score
from skincal.report.diagnosis_curves import curves_figure
from skincal.report.diagnosis_gap import gap_figure
from skincal.report.diagnosis_story import (
    effect_rows,
    headline,
    method_sentences,
    noise_rows,
    parameter_rows,
    percent,
    tone,
    verdict_sentences,
)
from skincal.report.diagnosis_where import where_figure
from skincal.report.fit_story import provenance_rows
from skincal.report.page import Picture, picture, rendered

if TYPE_CHECKING:
    from skincal.dataset import Dataset
    from skincal.diagnose.diagnosis import Diagnosis

SUMMARY = "diagnosis.json"
PAGE = "report.html"


@dataclass(frozen=True)
class _Section:
    """One figure of the report.

    Attributes:
        stem: of its file.
        title: above it.
        caption: how to read it.
        draw: makes it.
        place: before the signatures (1), after them (2), or after the table of effects (3).
    """

    stem: str
    title: str
    caption: str
    draw: Callable[[Diagnosis, Dataset], Figure]
    place: int = 1


SECTIONS = (
    _Section(
        "gap",
        "The gap, before and after",
        "Presses that neither the fit nor the choice of effects has seen. A press may place its contact within what "
        "its measured place is worth, alike before and after; nothing else is fitted to it. The black bar is what "
        "noise alone makes. The interval comes from drawing whole presses again.",
        gap_figure,
    ),
    _Section(
        "signature",
        "What is left, where it shows best",
        "Bars hold 95 %, from the scatter from press to press. Filled: presses that were fitted; hollow: presses "
        "that were kept for the end. Both sides have the same scale. Pose, E, S and places were fitted before "
        "either: what a curve shows is what they could not take up.",
        lambda found, _: curves_figure(found),
    ),
    _Section(
        "where",
        "Where simulation and data disagree",
        "Maps: taxels as they lie on the patch, u to the right, v up. Right: what part of the base model's excess, "
        "which is its squared residual beyond noise, lies in each phase. All presses.",
        lambda found, _: where_figure(found),
    ),
    _Section(
        "candidates",
        "What was tried",
        "Effects that were searched, parameters found on the presses that learn, scored on the presses that choose. "
        "In the grey band nothing can be told from chance, whatever the contact law. An effect is added when it is "
        "beyond the band and explains more of the excess than any other in a full fit with sensor and places; the "
        "search begins again with it in the model. Triangles: no better than nothing on presses that choose. Beside "
        "one effect that does not explain enough every other is fitted in full, and what explains most of the rest is "
        "added wherever it lies here, for there the scores err.",
        lambda found, _: candidates_figure(found),
        place=2,
    ),
    _Section(
        "audit",
        "What these presses can show at all",
        "Of an ideal test, before anything is fitted (`skincal audit`). Left: how small each effect may be and still "
        "be seen. Right: how well one effect imitates another; those framed in red cannot be told apart.",
        lambda found, _: audit_figure(found.audit),
        place=3,
    ),
)


def write_diagnosis_report(
    found: Diagnosis, dataset: Dataset, folder: Path, told: Mapping[str, Any], *, pages: bool = True
) -> None:
    """Writes ``diagnosis.json``, and ``report.html`` with its pictures, beside a calibration.

    The page holds its pictures itself and needs nothing from elsewhere; it can be sent to somebody as one file.

    Args:
        found: the diagnosis.
        dataset: that was diagnosed.
        folder: where to.
        told: the summary, plain values only.
        pages: whether page and pictures are wanted.
    """
    (folder / SUMMARY).write_text(json.dumps(told, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if not pages:
        return
    figures = [
        (
            section.place,
            picture(section.draw(found, dataset), section.stem, section.title, section.caption, folder),
        )
        for section in SECTIONS
    ]
    (folder / PAGE).write_text(_page(found, dataset, figures), encoding="utf-8")


def _page(found: Diagnosis, dataset: Dataset, figures: list[tuple[int, Picture]]) -> str:
    first, second, third = ([one for place, one in figures if place == k] for k in (1, 2, 3))
    return rendered(
        "diagnosis.html",
        name=dataset.folder.resolve().name if dataset.folder else "dataset",
        source=dataset.meta.source,
        tone=tone(found),
        headline=headline(found),
        verdict=verdict_sentences(found),
        findings=sorted(found.findings, key=lambda finding: finding.severity != "warning"),
        parameters=parameter_rows(found),
        signatures=[
            {
                "meaning": s.meaning,
                "share": percent(s.share),
                "p": f"{s.p_value:.2g}",
                "times": f"{s.times_null:.1f}" if s.times_null < 10 else f"{s.times_null:.0f}",
            }
            for s in found.signatures
        ],
        structure=f"{found.options.structure:g}",
        effects=effect_rows(found),
        critical=f"{critical_score(found):.2g}",
        next_presses=found.next_presses,
        plan=PLAN_FILE if found.next_plan is not None else "",
        noise=noise_rows(found),
        method=method_sentences(found),
        provenance=provenance_rows(found.calibration),
        first=first,
        second=second,
        third=third,
    )
