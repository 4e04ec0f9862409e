"""What is missing: effects that were named, and what was tried in each round."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from skincal.gap.candidates import Found
from skincal.gap.models import Model


@dataclass(frozen=True, eq=False)
class Named:
    """An effect that was named.

    Attributes:
        name: of the effect.
        consistent_with: names that these data cannot tell apart from it, itself first.
        share: part of the excess of its round that it explains.
        p_value: of the best score of a null session's effects reaching its score; of what was read off, or found by a
            full fit alone, reaching what that explains; of what only a full fit to some presses found, reaching what
            that explains of the others.
        by_places: whether the places of presses told it (:mod:`skincal.gap.places`), not the images.
    """

    name: str
    consistent_with: tuple[str, ...]
    share: float
    p_value: float
    by_places: bool = False


@dataclass(frozen=True, eq=False)
class Round:
    """What was tried in a round.

    Attributes:
        found: the search of each effect, best score first.
        excess: squared residual beyond noise before it, over the presses that choose.
        falls: fall of the squared residual by a full fit, of the contenders; presses were looked for again only with
            those that :func:`skincal.gap.contest.further` compares so.
        fits: the full fits.
        taken: the effect that was added; None where none was.
        passed_over: the effect that explained most, but only what one of its own kind leaves over; None where that
            did not happen.
    """

    found: tuple[Found, ...]
    excess: float
    falls: Mapping[str, float]
    fits: Mapping[str, Model] = field(default_factory=dict[str, Model])
    taken: str | None = None
    passed_over: str | None = None


@dataclass(frozen=True, eq=False)
class Choice:
    """What is missing.

    Attributes:
        before: the base model alone.
        after: with the effects that were named.
        named: them.
        rounds: what was tried.
        excess: squared residual beyond noise, before and after.
        values: that were read and looked at.
        law: root mean square of what another contact law explains, in units of the noise.
    """

    before: Model
    after: Model
    named: tuple[Named, ...]
    rounds: tuple[Round, ...]
    excess: tuple[float, float]
    values: int = 1
    law: float = 0.0

    @property
    def explained(self) -> float:
        """The part of the excess that the named effects explain; NaN where there is none."""
        first, last = self.excess
        return 1 - max(last, 0.0) / first if first > 0 else float("nan")

    @property
    def left(self) -> float:
        """Root mean square of what is left, in units of the noise."""
        return (max(self.excess[1], 0.0) / self.values) ** 0.5

    @property
    def closest(self) -> tuple[str, float] | None:
        """The effect that came closest to being named in the last round, and the part of what was left it explains.

        None where the last round had none that scored better than in null sessions.
        """
        last = self.rounds[-1] if self.rounds else None
        if last is None or last.taken is not None:
            return None
        name, fall = max(last.falls.items(), key=lambda item: item[1], default=("", 0.0))
        return (name, fall / last.excess) if fall > 0 else None
