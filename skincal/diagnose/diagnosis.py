"""What a diagnosis found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skincal.calibration import Calibration, Finding
from skincal.collect import Plan
from skincal.diagnose.audit import AuditReport
from skincal.diagnose.options import DiagnoseOptions
from skincal.effects import EFFECTS, EffectParameter
from skincal.gap.choice import Choice
from skincal.gap.heldout import Gap
from skincal.gap.models import Material
from skincal.gap.noise import NoiseFloor
from skincal.gap.null import Null
from skincal.inference.session import GapSession
from skincal.gap.signatures import Signature
from skincal.gap.split import Split
from skincal.model.arrays import FloatArray

Verdict = Literal["none", "effects", "unknown"]

_TOLD = 3
"""So many of the things that a residual depends on are told."""
_MEETS = 1e-6
"""A fit ends at a bound if it is as near to it, relative."""


@dataclass(frozen=True, eq=False)
class NamedEffect:
    """An effect that was named.

    Attributes:
        name: of the effect.
        consistent_with: names that these data cannot tell apart from it, itself first.
        p_value: of a null session doing as well.
        parameters: a number, or one a taxel or pose.
        intervals: low and high of each, 95 %.
        where: in a sentence, where the residual lies that is left without it: by the base model where nothing else is
            named, else by all that was named but this.
        share: part of the excess of its round that it explains; of the variance of where presses turn out to be, if
            places told it.
        by_places: whether the places of presses told it, not the images.
    """

    name: str
    consistent_with: tuple[str, ...]
    p_value: float
    parameters: Mapping[str, FloatArray]
    intervals: Mapping[str, tuple[FloatArray, FloatArray]]
    where: str
    share: float
    by_places: bool = False

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Parameters that ended at a bound of what is allowed, where the best value may lie beyond.

        A shape that ends at one of its two kinds does not count, nor what is neutral, nor zero, below which nothing is.
        """
        return tuple(
            p.name
            for p in EFFECTS[self.name].parameters
            if p.name in self.parameters
            and (p.role == "strength" or p.scale == "log")
            and _met(np.atleast_1d(self.parameters[p.name]), p)
        )


def _met(values: FloatArray, p: EffectParameter) -> bool:
    """Whether any of some values is at a bound of its parameter beyond which others could be."""
    bounds = [end for end in (p.low, p.high) if end not in (p.neutral, 0.0)]
    return any(bool(np.isclose(values, end, rtol=_MEETS, atol=0.0).any()) for end in bounds)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """A verdict and everything it rests on.

    Attributes:
        verdict: ``none`` (nothing missing can be shown), ``effects`` (named), ``unknown`` (something is missing that
            none of the known effects explains).
        effects: that were named, strongest first.
        unexplained: whether something significant is left beside them.
        where: in a sentence, where the residual lies that the base model leaves.
        gap: on presses that nobody has fitted.
        floor: the noise.
        audit: what these presses can show at all.
        null: simulated sessions in which nothing is missing.
        choice: how effects were chosen.
        signatures: on what the residual depends, strongest first.
        findings: glitches, jumps, dead taxels, what the data lack.
        split: which presses learned, chose, and were kept for the end.
        session: what was looked at.
        material: the same as it was split.
        calibration: with the effects added; the given one where none are.
        options: settings.
        seed: of the randomness.
        next_presses: in words, the presses that would tell what is still open.
        refuted: whether what was found is not named, because presses that nobody has fitted are surely further off.
        wide_open: whether it is not named because surely too little of the gap on those presses is closed with it.
        next_plan: these presses, where there are such; it is written beside the report.
    """

    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    unexplained: bool
    where: str
    gap: Gap
    floor: NoiseFloor
    audit: AuditReport
    null: Null
    choice: Choice
    signatures: tuple[Signature, ...]
    findings: tuple[Finding, ...]
    split: Split
    session: GapSession
    material: Material
    calibration: Calibration
    options: DiagnoseOptions
    seed: int
    next_presses: tuple[str, ...] = ()
    next_plan: Plan | None = None
    refuted: bool = False
    wide_open: bool = False

    @property
    def taken_back(self) -> tuple[str, ...]:
        """What was found, and is not named because of presses that nobody has fitted."""
        return tuple(one.name for one in self.choice.named) if self.refuted or self.wide_open else ()

    @property
    def depends_on(self) -> str:
        """On what the residual of the base model depends most, and how much of the excess goes along; may be empty.

        Shares overlap, as is said to whoever reads them.
        """
        clear = [s for s in self.signatures if s.p_value <= self.options.choice.significant][:_TOLD]
        words = [f"{s.meaning} ({100 * min(s.share, 1.0):.0f} % of it)" for s in clear]
        return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)

    @property
    def only_places(self) -> bool:
        """Whether all that is named lives in the places: presses that may move take it up, and images show no gap."""
        return bool(self.effects) and all(one.by_places for one in self.effects)
