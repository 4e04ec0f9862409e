"""The result of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal

import numpy as np

from skincal.calibration import Calibration, Finding, FittedLaw
from skincal.collect import Plan
from skincal.diagnosis.audit import AuditReport
from skincal.diagnosis.gap import Gap
from skincal.diagnosis.observed import NoiseFloor, Observed
from skincal.diagnosis.residual_location import ResidualShare
from skincal.effects import EFFECTS, EffectParameter
from skincal.inference.search_result import SearchResult
from skincal.model.arrays import FloatArray
from skincal.shown import Shown

Verdict = Literal["none", "effects", "unknown"]
SENTENCES: Final[Mapping[Verdict, str]] = {
    "none": "these presses show no missing effect",
    "effects": "named effects are missing",
    "unknown": "something is missing that no known effect explains",
}
"""Verdicts in words, without capital and full stop."""
_BOUND_RTOL = 1e-6
"""Relative tolerance within which a fitted value counts as at a bound."""


@dataclass(frozen=True, eq=False)
class NamedEffect:
    """An effect that the diagnosis has named.

    Attributes:
        name: name of the effect.
        consistent_with: names that these data cannot distinguish from it, itself first.
        p_value: share of null sessions that gain as much.
        gain: gain in log-likelihood on held-out presses [nats].
        parameters: fitted values: one number, or one for each taxel or pose.
        intervals: ends of the 95 % interval of each parameter.
        where: sentence that says where the residual of the model without the effect lies.
        share: share of the excess of the base model that it explains.
        by_places: whether it acts on contact positions alone, so that images hardly show it.
    """

    name: str
    consistent_with: tuple[str, ...]
    p_value: float
    gain: float
    parameters: Mapping[str, FloatArray]
    intervals: Mapping[str, tuple[FloatArray, FloatArray]]
    where: str
    share: float
    by_places: bool = False

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Parameters that ended at a bound of their range; the best value may lie beyond."""
        return tuple(
            p.name
            for p in EFFECTS[self.name].parameters
            if p.name in self.parameters
            and (p.role == "strength" or p.scale == "log")
            and _is_at_bound(np.atleast_1d(self.parameters[p.name]), p)
        )


def _is_at_bound(values: FloatArray, p: EffectParameter) -> bool:
    bounds = [end for end in (p.low, p.high) if end not in (p.neutral, 0.0)]
    return any(bool(np.isclose(values, end, rtol=_BOUND_RTOL, atol=0.0).any()) for end in bounds)


@dataclass(frozen=True, eq=False)
class Diagnosis(Shown):
    """A verdict with its evidence.

    Attributes:
        verdict: ``none``, ``effects`` or ``unknown`` (:data:`SENTENCES` says it in words).
        effects: the named effects, in the order in which they were found.
        unexplained: whether a significant residual remains.
        where: sentence that says where the residual of the base model lies.
        gap: error on the test presses before and after.
        floor: noise floor.
        audit: what these presses can show.
        found: result of the search.
        observed: the session as the inference uses it.
        depends: parts of the session with more of the residual than their size suggests, strongest first.
        findings: notes and warnings, such as outliers, dead taxels or missing data.
        calibration: the given calibration with effects and contact law added; unchanged if there are none.
        seed: seed of the randomness.
        next_presses: sentences that say which presses would answer the open questions.
        next_plan: plan of these presses, if there is one.
        taken_back: effects that the search found, but the test presses or the remaining residual contradict.
    """

    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    unexplained: bool
    where: str
    gap: Gap
    floor: NoiseFloor
    audit: AuditReport
    found: SearchResult
    observed: Observed
    depends: tuple[ResidualShare, ...]
    findings: tuple[Finding, ...]
    calibration: Calibration
    seed: int
    next_presses: tuple[str, ...] = ()
    next_plan: Plan | None = None
    taken_back: tuple[str, ...] = ()

    def __repr__(self) -> str:
        names = "; ".join(" or ".join(effect.consistent_with) for effect in self.effects)
        closed = (
            f", {100 * self.gap.closed:.0f} % of the gap closed"
            if names and np.isfinite(self.gap.closed)
            else ""
        )
        return f"<Diagnosis {self.verdict}{': ' if names else ''}{names}{closed}>"

    @property
    def sentence(self) -> str:
        """The verdict in words, without capital and full stop."""
        return SENTENCES[self.verdict]

    @property
    def contact_law(self) -> FittedLaw | None:
        """Contact law of the new calibration, if it differs from the elastic foundation."""
        return None if self.verdict == "unknown" else self.calibration.contact_law

    @property
    def only_positions(self) -> bool:
        """True if all named effects act on contact positions alone, so that images show no gap."""
        return bool(self.effects) and all(effect.by_places for effect in self.effects)


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
