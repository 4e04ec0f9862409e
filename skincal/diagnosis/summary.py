"""Summarize a diagnosis as plain values for other programs, as ``skincal diagnose --json`` prints it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from skincal.diagnosis.adaptive_collection import CollectionResult
from skincal.diagnosis.diagnosis import Diagnosis, NamedEffect


def summary(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return verdict, effects, audit, gap, candidates and findings as plain values."""
    d, gap = diagnosis, diagnosis.gap
    is_named, law = d.verdict == "effects", d.contact_law
    has_closed = is_named and np.isfinite(gap.closed)
    numbers: dict[str, Any] = {
        "heldout_rmse_before": gap.before,
        "heldout_rmse_after": gap.after if is_named or law else gap.before,
        "heldout_rmse_with_taken_back": gap.after if d.taken_back else None,
        "noise_floor_rmse": gap.floor,
        "closed": gap.closed if has_closed else None,
        "closed_interval": list(gap.interval) if has_closed else None,
        "presses": len(gap.errors),
        "frames": gap.frames,
    }
    if any(e.by_places for e in d.effects):
        numbers["slack_rms_before_m"] = gap.slack_before_m
        numbers["slack_rms_after_m"] = gap.slack_after_m
    return {
        "verdict": d.verdict,
        "effects": [_effect(e) | {"calibrated": _refitted_parameters(d, e)} for e in d.effects],
        "contact_law": None if law is None else asdict(law.law) | {"intervals": dict(law.intervals)},
        "unexplained": d.unexplained,
        "refuted": bool(d.taken_back) and gap.is_refuted,
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


def collection_summary(result: CollectionResult) -> dict[str, Any]:
    """Return the outcome of a diagnosis with further presses as plain values."""
    return {
        "presses": result.made,
        "rounds": result.rounds,
        "settled": not result.open and result.diagnosis.verdict != "unknown",
        "reason": result.reason,
    }


def _refitted_parameters(diagnosis: Diagnosis, effect: NamedEffect) -> dict[str, Any]:
    """Return the parameters of an effect in the new calibration, which is fitted to the test presses as well."""
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
    """Return held-out gain, its standard error, required gain and p-value of every candidate, round by round."""
    return [
        [
            {
                "name": c.name,
                "score": c.gain,
                "error": c.error,
                "sure": c.significance,
                "limit": c.limit,
                "p_value": c.p_value,
            }
            for c in candidates
        ]
        for candidates in diagnosis.found.rounds
    ]
