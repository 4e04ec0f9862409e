"""The report of a diagnosis: JSON for programs, and one self-contained page with its figures as files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import escape

from skincal.diagnosis.next_presses import PLAN_FILE
from skincal.effects import EFFECTS
from skincal.report.audit import audit_figure
from skincal.report.diagnosis_figures import candidates_figure, curves_figure, gap_figure, where_figure
from skincal.report.diagnosis_words import headline, tone, verdict_sentences
from skincal.report.fit_story import provenance_rows
from skincal.report.page import picture, rendered

if TYPE_CHECKING:
    from skincal.dataset import Dataset
    from skincal.diagnosis.diagnosis import Diagnosis

SUMMARY = "diagnosis.json"
PAGE = "report.html"
SECTIONS = (
    (
        "gap",
        "The gap before and after",
        "Test presses, which neither the fit nor the selection of effects has used. The contact of "
        "a press may move within the "
        "uncertainty of its measured position, before and after alike. The bar is the noise alone.",
        gap_figure,
    ),
    (
        "signature",
        "Counts over time, measured and simulated",
        "The presses that tell most: those that gain most by what was named, else those whose base model errs most; "
        "each on the taxel that tells most. With what is missing in the model, its line goes through the points.",
        curves_figure,
    ),
    (
        "where",
        "Where simulation and data disagree",
        "Maps: taxels on the patch, u to the right, v up. Right: parts of the session that hold more of the "
        "excess residual than their size suggests.",
        where_figure,
    ),
    (
        "candidates",
        "What was tried",
        "Logarithm of the likelihood that each effect gains on presses that its fit has "
        "not seen, with its standard error. Grey: what it seldom exceeds in simulated sessions of these presses with "
        "nothing hidden, under several contact laws; the line is what is asked for: a quarter more, 8 nats at least. "
        "An effect is named beyond it; the search begins again with it in the model.",
        candidates_figure,
    ),
)


def write_diagnosis_report(
    found: Diagnosis, dataset: Dataset, folder: Path, told: Mapping[str, Any], *, pages: bool = True
) -> None:
    """Write ``diagnosis.json``, and ``report.html`` with its figures, next to a calibration.

    Args:
        found: the diagnosis.
        dataset: the dataset that was diagnosed.
        folder: folder to write to.
        told: the summary, with plain values only.
        pages: whether to write the page and its figures.
    """
    (folder / SUMMARY).write_text(json.dumps(told, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if not pages:
        return
    unit = dataset.meta.sensor.unit
    figures = [
        picture(draw(found, dataset), stem, title, caption, folder, unit)
        for stem, title, caption, draw in SECTIONS
    ]
    caption = (
        "By an ideal test, before any fit (`skincal audit`). Left: the smallest strength at which "
        "each effect is "
        "visible. Right: the similarity of two effects; those framed in red cannot be distinguished."
    )
    last = picture(audit_figure(found.audit), "audit", "What these presses can show", caption, folder)
    noise = found.floor
    page = rendered(
        "diagnosis.html",
        unit,
        name=escape(dataset.folder.resolve().name if dataset.folder else "dataset"),
        source=escape(dataset.meta.source),
        tone=tone(found),
        headline=headline(found),
        verdict=verdict_sentences(found),
        findings=sorted(found.findings, key=lambda finding: finding.severity != "warning"),
        parameters=_parameters(found),
        effects=_effects(found),
        next_presses=found.next_presses,
        plan=PLAN_FILE if found.next_plan is not None else "",
        noise=[
            ("one frame, before rounding", f"{noise.frame_counts:.3g} counts", noise.frame_from),
            ("mean of a hold", f"{noise.mean_counts:.3g} counts", noise.mean_from),
            ("grows with the signal by", f"{100 * noise.grows:.1f} %", noise.frame_from),
        ],
        method=_method(found),
        provenance=provenance_rows(found.calibration),
        figures=figures,
        last=last,
    )
    (folder / PAGE).write_text(page, encoding="utf-8")


def _parameters(found: Diagnosis) -> list[dict[str, str]]:
    rows: list[dict[str, str]] = []
    for e in found.effects:
        final = next((c.parameters for c in found.calibration.effects if c.name == e.name), {})
        for name, (low, high) in e.intervals.items():
            p = EFFECTS[e.name].parameter(name)
            array = np.asarray(e.parameters[name])
            several = array.ndim > 0
            value = f"{array.min():.3g} to {array.max():.3g}" if several else f"{float(array):.4g}"
            interval = "one per value" if several else f"{float(low):.4g} to {float(high):.4g}"
            last = "" if several or name not in final else f"{float(np.asarray(final[name])):.4g}"
            rows.append(
                {
                    "effect": e.name,
                    "name": name,
                    "meaning": p.description,
                    "value": value,
                    "interval": interval,
                    "final": last,
                    "neutral": f"{p.neutral:g}",
                }
            )
    return rows


def _effects(found: Diagnosis) -> list[dict[str, str]]:
    first = {t.name: t for t in found.found.rounds[0]} if found.found.rounds else {}
    rows = []
    for name, effect in EFFECTS.items():
        smallest, tried = found.audit.effects[name].smallest_strength, first.get(name)
        rival = next((e.name for e in found.effects if name in e.consistent_with[1:]), "")
        kind, outcome = "no", "no evidence"
        if name in {e.name for e in found.effects}:
            kind, outcome = "named", "named and added"
        elif rival:
            kind, outcome = "rival", f"cannot be distinguished from {rival}"
        elif name in found.audit.cannot_see:
            kind, outcome = "blind", f"not visible: {found.audit.reasons.get(name, '')}"
        elif tried is not None and tried.good:
            outcome = "improves the fit, but others explain more"
        seen = "never" if not np.isfinite(smallest) else f"{smallest:.2g}"
        score = "" if tried is None else f"{tried.gain:.1f} of {tried.limit:.1f}"
        rows.append(
            {
                "name": name,
                "meaning": effect.meaning,
                "smallest": seen,
                "tried": score,
                "outcome": outcome,
                "kind": kind,
            }
        )
    return rows


def _method(found: Diagnosis) -> list[str]:
    held, session = found.observed.held, found.observed.session
    presses = len(np.unique(session.press[session.press >= 0]))
    laws = list(dict.fromkeys(found.found.null.laws))
    return [
        f"{presses} presses: {presses - int(held.sum())} for fitting and selection, held out "
        f"in turn, {int(held.sum())} reserved for the final test.",
        f"{len(session)} observations were used"
        + (", each the mean of a few frames." if session.has_frames else ", the means of the holds."),
        f"{len(found.found.null.laws)} null sessions simulate these presses without effects, under {', '.join(laws)}.",
        f"Seed {found.seed}.",
    ]
