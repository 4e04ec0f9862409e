"""What a diagnosis found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skincal.calibration import Calibration, Finding, FittedLaw
from skincal.collect import Plan
from skincal.diagnosis.audit import AuditReport
from skincal.diagnosis.gap import Gap
from skincal.diagnosis.observed import NoiseFloor, Observed
from skincal.diagnosis.where import Share
from skincal.effects import EFFECTS, EffectParameter
from skincal.inference.search_result import SearchResult
from skincal.model.arrays import FloatArray
from skincal.shown import Shown

Verdict = Literal["none", "effects", "unknown"]
_MEETS = 1e-6
"""A fit ends at a bound if it is as near to it, relative."""


@dataclass(frozen=True, eq=False)
class NamedEffect:
    """An effect that was named.

    Attributes:
        name: of the effect.
        consistent_with: names that these data cannot tell apart from it, itself first.
        p_value: of a null session gaining as much.
        gain: that the effect adds on presses not fitted [nats].
        parameters: a number, or one a taxel or pose.
        intervals: low and high of each, 95 %.
        where: in a sentence, where the residual lies that is left without it.
        share: part of the excess of the base model that it explains.
        by_places: whether it lives in the places of presses, so that images hardly show it.
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
        """Parameters that ended at a bound of what is allowed, where the best value may lie beyond."""
        return tuple(
            p.name
            for p in EFFECTS[self.name].parameters
            if p.name in self.parameters
            and (p.role == "strength" or p.scale == "log")
            and _met(np.atleast_1d(self.parameters[p.name]), p)
        )


def _met(values: FloatArray, p: EffectParameter) -> bool:
    bounds = [end for end in (p.low, p.high) if end not in (p.neutral, 0.0)]
    return any(bool(np.isclose(values, end, rtol=_MEETS, atol=0.0).any()) for end in bounds)


@dataclass(frozen=True, eq=False)
class Diagnosis(Shown):
    """A verdict and everything it rests on.

    Attributes:
        verdict: ``none`` (nothing missing can be shown), ``effects`` (named), ``unknown`` (something is missing that
            none of the known effects explains).
        effects: that were named, in the order in which they were found.
        unexplained: whether something significant is left beside them.
        where: in a sentence, where the residual lies that the base model leaves.
        gap: on presses that nobody has fitted.
        floor: the noise.
        audit: what these presses can show at all.
        found: what the search ended with.
        observed: what was looked at.
        depends: on what the residual depends, strongest first.
        findings: glitches, dead taxels, what the data lack.
        calibration: with effects and contact law added; the given one where there are none.
        seed: of the randomness.
        next_presses: in words, the presses that would tell what is still open.
        next_plan: these presses, where there are such.
        taken_back: what was found, and is not named because of presses that nobody has fitted, or of what is left.
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
    depends: tuple[Share, ...]
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
    def contact_law(self) -> FittedLaw | None:
        """How the contact differs from the elastic foundation, where the new calibration has it."""
        return None if self.verdict == "unknown" else self.calibration.contact_law

    @property
    def only_places(self) -> bool:
        """Whether all that is named lives in the places: presses that may move take it up, and images show no gap."""
        return bool(self.effects) and all(one.by_places for one in self.effects)
