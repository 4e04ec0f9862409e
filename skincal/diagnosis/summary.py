"""A diagnosis as other programs read it (contract, ``skincal diagnose --json``)."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from skincal.diagnosis.diagnosis import Diagnosis, NamedEffect
from skincal.diagnosis.settle import Settled


def summary(diagnosis: Diagnosis) -> dict[str, Any]:
    """Verdict, effects, what cannot be seen, the gap, and what it rests on, as plain values."""
    d, gap = diagnosis, diagnosis.gap
    named, law = d.verdict == "effects", d.contact_law
    told = named and np.isfinite(gap.closed)
    numbers: dict[str, Any] = {
        "heldout_rmse_before": gap.before,
        "heldout_rmse_after": gap.after if named or law else gap.before,
        "heldout_rmse_with_taken_back": gap.after if d.taken_back else None,
        "noise_floor_rmse": gap.floor,
        "closed": gap.closed if told else None,
        "closed_interval": list(gap.interval) if told else None,
        "presses": len(gap.errors),
        "frames": gap.frames,
    }
    if any(e.by_places for e in d.effects):
        numbers["slack_rms_before_m"] = gap.slack_before_m
        numbers["slack_rms_after_m"] = gap.slack_after_m
    return {
        "verdict": d.verdict,
        "effects": [_effect(e) | {"calibrated": _calibrated(d, e)} for e in d.effects],
        "contact_law": None if law is None else asdict(law.law) | {"intervals": dict(law.intervals)},
        "unexplained": d.unexplained,
        "refuted": bool(d.taken_back) and gap.refutes,
        "taken_back": list(d.taken_back),
        "where": d.where,
        "cannot_see": list(d.audit.cannot_see),
        "why_not": dict(d.audit.reasons),
        "audit": d.audit.rows,
        "gap": numbers,
        "candidates": _candidates(d),
        "depends": [vars(s) for s in d.depends],
        "findings": [f.as_json() for f in d.findings],
        "noise": vars(d.floor),
        "noise_frame_counts": d.floor.frame_counts,
        "null_sessions": len(d.found.null.laws),
        "left": d.found.misfit.tolist(),
        "next_presses": list(d.next_presses),
        "seed": d.seed,
    }


def collected(settled: Settled) -> dict[str, Any]:
    """What a diagnosis with further presses came to, as plain values."""
    return {
        "presses": settled.made,
        "rounds": settled.rounds,
        "settled": not settled.open and settled.diagnosis.verdict != "unknown",
        "reason": settled.reason,
    }


def _calibrated(diagnosis: Diagnosis, effect: NamedEffect) -> dict[str, Any]:
    """The parameters in the new calibration, which were fitted once more, to the presses of the end as well."""
    own = [e.parameters for e in diagnosis.calibration.effects if e.name == effect.name]
    return {name: np.asarray(value).tolist() for given in own for name, value in given.items()}


def _effect(effect: NamedEffect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "consistent_with": list(effect.consistent_with),
        "p_value": effect.p_value,
        "gain_nats": effect.gain,
        "parameters": {name: np.asarray(value).tolist() for name, value in effect.parameters.items()},
        "intervals": {name: [low.tolist(), high.tolist()] for name, (low, high) in effect.intervals.items()},
        "where": effect.where,
        "share": effect.share,
        "by_places": effect.by_places,
        "at_bound": list(effect.at_bound),
    }


def _candidates(diagnosis: Diagnosis) -> list[list[dict[str, Any]]]:
    """What was tried in each round: gain on presses not fitted, its standard error, and the null's limit."""
    return [
        [
            {
                "name": t.name,
                "score": t.gain,
                "error": t.error,
                "sure": t.significance,
                "limit": t.limit,
                "p_value": t.p_value,
            }
            for t in one
        ]
        for one in diagnosis.found.rounds
    ]
