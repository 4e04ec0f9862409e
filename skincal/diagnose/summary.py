"""A diagnosis as other programs read it (contract, ``skincal diagnose --json``)."""

from __future__ import annotations

from typing import Any

import numpy as np

from skincal.diagnose.diagnosis import Diagnosis, NamedEffect
from skincal.gap.noise import NoiseFloor

SLACK_EFFECT = "contact_offset"
"""It lives in the positions: what it takes away is slack, not error of the images."""


def summary(diagnosis: Diagnosis) -> dict[str, Any]:
    """Verdict, effects, what cannot be seen, the gap, and what it rests on, as plain values."""
    d, gap = diagnosis, diagnosis.gap
    named = d.verdict == "effects"
    told = named and np.isfinite(gap.closed)
    numbers: dict[str, Any] = {
        "heldout_rmse_before": gap.before,
        "heldout_rmse_after": gap.after if named else gap.before,
        # What was found and taken back would have left so much.
        "heldout_rmse_with_taken_back": gap.after if d.taken_back else None,
        "noise_floor_rmse": gap.floor,
        "closed": gap.closed if told else None,
        "closed_interval": list(gap.interval) if told else None,
        "presses": gap.presses,
        "frames": gap.frames,
    }
    if any(e.name == SLACK_EFFECT for e in d.effects):
        numbers["slack_rms_before_m"] = gap.slack_before_m
        numbers["slack_rms_after_m"] = gap.slack_after_m
    return {
        "verdict": d.verdict,
        "effects": [_effect(e) | {"calibrated": _calibrated(d, e)} for e in d.effects],
        "unexplained": d.unexplained,
        "refuted": d.refuted,
        "wide_open": d.wide_open,
        "taken_back": list(d.taken_back),
        "where": d.where if d.verdict != "unknown" or not d.depends_on else f"{d.where}; {_along(d)}",
        "cannot_see": list(d.audit.cannot_see),
        "why_not": dict(d.audit.reasons),
        "audit": d.audit.rows,
        "gap": numbers,
        "explained": d.choice.explained if d.choice.excess[0] > 0 else None,
        "candidates": _candidates(d),
        "signatures": [vars(s) for s in d.signatures],
        "findings": [vars(f) for f in d.findings],
        "noise": _noise(d.floor),
        "noise_frame_counts": d.floor.frame_counts,
        "null_sessions": len(d.null.laws),
        "next_presses": list(d.next_presses),
        "seed": d.seed,
    }


def _along(diagnosis: Diagnosis) -> str:
    return f"it goes along with {diagnosis.depends_on}; these shares overlap"


def _noise(floor: NoiseFloor) -> dict[str, Any]:
    """The noise as it was used: how much, where that lies, and what showed it."""
    repeated = bool(np.isfinite(floor.repeat_counts))
    return {
        "frame_counts": floor.frame_counts,
        "frame_interval": list(floor.frame_interval),
        "frame_from": floor.frame_from,
        "mean_counts": floor.mean_counts,
        "mean_interval": list(floor.mean_interval),
        "mean_from": floor.mean_from,
        "measured": floor.measured,
        "repeat_counts": floor.repeat_counts if repeated else None,
        "repeat_interval": list(floor.repeat_interval) if repeated else None,
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
        "parameters": {name: value.tolist() for name, value in effect.parameters.items()},
        "intervals": {name: [low.tolist(), high.tolist()] for name, (low, high) in effect.intervals.items()},
        "where": effect.where,
        "share": effect.share,
        "by_places": effect.by_places,
        "at_bound": list(effect.at_bound),
    }


def _candidates(diagnosis: Diagnosis) -> list[list[dict[str, Any]]]:
    """What was tried in each round: scores on the presses that choose, and what a full fit explained.

    An effect that was passed over explained most, but no more than another of its kind leaves over.
    """
    null = diagnosis.null
    return [
        [
            {
                "name": f.effect,
                "score": f.scored,
                "p_value": null.p_value(f.effect, f.scored),
                "explained_by_full_fit": one.falls.get(f.effect),
                "passed_over": f.effect == one.passed_over,
            }
            for f in one.found
        ]
        for one in diagnosis.choice.rounds
    ]
