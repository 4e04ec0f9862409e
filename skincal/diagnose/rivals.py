"""Which explanations a choice has left open, each fitted in full."""

from __future__ import annotations

from dataclasses import dataclass

from skincal.gap.choice import Choice, Round
from skincal.gap.models import Model

NEAR = 0.8
"""An effect that a full fit found to explain this part of what the named one does is a near rival."""

_FAR = 400.0
"""A near rival so far off, squared, in units of the noise, need not be set apart any more."""

MOST = 2


@dataclass(frozen=True, eq=False)
class Pair:
    """An effect that was named, and a rival.

    Attributes:
        first: the one that was named.
        second: the rival.
        alike: whether the data cannot tell them apart; else the rival only comes near.
        apart: squared distance on the presses there are: what the first explains beyond the second.
        unlike: the same as a part of what the first explains.
        models: with the one and with the other, fitted in the round in which the first was named.
    """

    first: str
    second: str
    alike: bool
    apart: float
    unlike: float
    models: tuple[Model, Model]


def pairs_of(choice: Choice, most: int = MOST) -> tuple[Pair, ...]:
    """Pairs that more presses should set apart: names that cannot be told apart, and near rivals, the closest first."""
    found: list[Pair] = []
    named = {n.name for n in choice.named}
    for one in choice.named:
        own = _round_of(choice, one.name)
        if own is None:
            continue
        best = own.falls[one.name]
        for rival in (name for name in own.fits if name not in named):
            alike, apart = rival in one.consistent_with, max(0.0, best - own.falls[rival])
            if alike or (own.falls[rival] >= NEAR * best and apart < _FAR):
                models = own.fits[one.name], own.fits[rival]
                found.append(Pair(one.name, rival, alike, apart, min(1.0, apart / best), models))
    return tuple(sorted(found, key=lambda p: p.unlike)[:most])


def _round_of(choice: Choice, name: str) -> Round | None:
    """The round in which an effect was named: the last that tried it."""
    return next((r for r in reversed(choice.rounds) if name in r.fits and r.falls[name] > 0), None)
