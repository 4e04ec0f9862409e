"""Outcome of a diagnosis of one session, beside its hidden truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from benchmarks.blind.suites import CLASS_OF

Record = dict[str, Any]


class OutcomeError(ValueError):
    """A diagnosis that is not as the contract has it."""


@dataclass(frozen=True)
class Named:
    """An effect that was named.

    Attributes:
        name: the first choice.
        consistent_with: names that cannot be told from it, itself among them.
    """

    name: str
    consistent_with: frozenset[str]


@dataclass(frozen=True)
class Outcome:
    """One session.

    Attributes:
        label: what was hidden.
        verdict: ``none``, ``effects`` or ``unknown``.
        named: effects in the order they were named; none unless the verdict is ``effects``.
        unexplained: whether something is left that the named effects do not explain.
        cannot_see: names that these presses cannot show.
        gap: of the held-out presses, as the diagnosis told it.
        wall_s, cpu_s: that the diagnosis took.
        best_p: the smallest p-value of a score in the first round; 1 where no effect was searched.
        calibrated: best value, low and high end of the new calibration's parameters, where they were kept.
    """

    label: Record
    verdict: str
    named: Sequence[Named]
    unexplained: bool
    cannot_see: frozenset[str]
    gap: Record
    wall_s: float = 0.0
    cpu_s: float = 0.0
    best_p: float = 1.0
    calibrated: Mapping[str, Sequence[float]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        label: Record,
        said: Record,
        wall_s: float = 0.0,
        cpu_s: float = 0.0,
        calibrated: Mapping[str, Sequence[float]] | None = None,
    ) -> Outcome:
        """From the JSON of ``skincal diagnose``.

        Raises:
            OutcomeError: the JSON is not as the contract has it.
        """
        verdict = said.get("verdict")
        if verdict not in ("none", "effects", "unknown"):
            raise OutcomeError(
                f"{label['session']}: verdict: expected none, effects or unknown; got {verdict!r}"
            )
        effects = said.get("effects", []) if verdict == "effects" else []
        if verdict == "effects" and not effects:
            raise OutcomeError(f"{label['session']}: the verdict is effects, but none is named")
        named = [Named(e["name"], frozenset([e["name"], *e.get("consistent_with", [])])) for e in effects]
        gap = said.get("gap") or {}
        seen = frozenset(said.get("cannot_see", []))
        first = next(iter(said.get("candidates") or [[]]))
        best_p = min((float(tried["p_value"]) for tried in first), default=1.0)
        return cls(
            label, str(verdict), named, bool(said.get("unexplained")), seen, gap, wall_s, cpu_s, best_p,
            calibrated or {},
        )  # fmt: skip

    @property
    def hidden(self) -> list[str]:
        """Names of the hidden effects of the catalogue."""
        if self.label["expected"] != "effects":
            return []
        return [effect["name"] for effect in self.label["effects"]]

    @property
    def g(self) -> float:
        """Strength of what is hidden; of the weakest where there are several."""
        return min((effect["strength_g"] for effect in self.label["effects"]), default=0.0)

    @property
    def names(self) -> list[str]:
        """First choices."""
        return [effect.name for effect in self.named]

    def found(self, name: str) -> bool:
        """Return True if a name is in a reported set."""
        return any(name in effect.consistent_with for effect in self.named)

    def right_class(self) -> bool:
        """Return True if the first named effect has the class of a hidden one."""
        return bool(self.named) and CLASS_OF.get(self.names[0]) in {CLASS_OF[name] for name in self.hidden}

    def wrong(self) -> list[Named]:
        """Named effects whose set holds nothing that is hidden."""
        return [effect for effect in self.named if not effect.consistent_with & set(self.hidden)]

    @property
    def set_size(self) -> float:
        """Mean number of names in a reported set; NaN if nothing was named."""
        sizes = [len(effect.consistent_with) for effect in self.named]
        return sum(sizes) / len(sizes) if sizes else float("nan")
