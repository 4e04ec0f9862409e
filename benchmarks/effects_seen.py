"""Identifiability of every effect in the paper's presses, static and with frames, and in a full session.

``python benchmarks/effects_seen.py`` writes ``benchmarks/results/effects_seen.json``, which the pages of the effects
show: whether a typical case (strength 1) is visible, from which strength on, which effects imitate it and how well, and
what is missing where it is not visible. Pose, E and S are nominal. A plan does not say which tangential forces there
will be; here each press is given one of a random direction, SHEAR_N rms along each axis, so that ``shear`` has a row.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from skincal.collect import Mount, Plan, full_plan, paper_plan
from skincal.dataset import read_dataset
from skincal.diagnosis.audit import audit_dataset, audit_planned
from skincal.diagnosis.invisible_effects import EffectAudit
from skincal.diagnosis.planned_session import plan_session
from skincal.robot import hand_named
from skincal.version import __version__

ROOT = Path(__file__).parent.parent
RESULT = ROOT / "benchmarks" / "results" / "effects_seen.json"
STATIC = ROOT / "data" / "paper-like"
SEED = 1
SHEAR_N = 0.3
LIKEST = 4
"""So many of the best imitations are kept."""


def static() -> tuple[dict[str, EffectAudit], dict[str, str], int]:
    """The bundled session of static presses without times and covariates."""
    report = audit_dataset(read_dataset(STATIC), None, np.random.default_rng(SEED))
    return dict(report.effects), dict(report.reasons), report.presses


def planned(plan: Plan) -> tuple[dict[str, EffectAudit], dict[str, str], int]:
    """A plan on the bundled hand."""
    description = hand_named()
    rng = np.random.default_rng(SEED)
    session = plan_session(plan, description)
    shear = rng.normal(0.0, SHEAR_N, (len(plan), 2))[np.maximum(session.row, 0)]
    session = replace(session, samples=replace(session.samples, shear_n=shear))
    report = audit_planned(session, description, None, rng)
    return dict(report.effects), dict(report.reasons), len(plan)


def row(found: EffectAudit, reasons: dict[str, str]) -> dict[str, Any]:
    """Return the record of one effect."""
    likest = sorted(found.overlaps.items(), key=lambda pair: -pair[1])[:LIKEST] if found.distance > 0 else []
    smallest = found.smallest_strength
    return {
        "visible": found.visible,
        "smallest_strength": float(f"{smallest:.2g}") if np.isfinite(smallest) else None,
        "consistent_with": list(found.consistent_with),
        "imitated_by": {name: round(cosine, 2) for name, cosine in likest},
        "reason": reasons.get(found.name),
    }


def main() -> None:
    """Audits the three sessions and writes the result."""
    layout = Mount.of(hand_named().meta).layout
    sessions = {
        "paper_static": static(),
        "paper_with_frames": planned(paper_plan(np.random.default_rng(SEED), layout)),
        "full": planned(full_plan(np.random.default_rng(SEED), layout, second_indenter_m=0.004)),
    }
    content = {
        "command": "python benchmarks/effects_seen.py",
        "version": __version__,
        "seed": SEED,
        "shear_rms_n": SHEAR_N,
        "sessions": {
            name: {"presses": presses, "effects": {key: row(one, reasons) for key, one in found.items()}}
            for name, (found, reasons, presses) in sessions.items()
        },
    }
    RESULT.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
