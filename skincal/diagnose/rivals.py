"""Which explanations a choice has left open, and where the search for each began."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skincal.gap.choose import Choice, Round
from skincal.gap.free import Coordinate
from skincal.gap.hypothesis import Parameters
from skincal.model.arrays import FloatArray

NEAR = 0.8
"""An effect that a full fit found to explain this part of what the named one does is a near rival."""

MOST = 3

Start = tuple[tuple[Coordinate, ...], FloatArray, Mapping[str, Parameters]]


@dataclass(frozen=True, eq=False)
class Pair:
    """An effect that was named, and a rival.

    Attributes:
        first: the one that was named.
        second: the rival.
        apart: squared distance on the presses there are: what the first explains beyond the second.
        unlike: the same as a part of what the first explains.
        start: numbers of the model with the rival in the place of the first, where they start, and what is held.
    """

    first: str
    second: str
    apart: float
    unlike: float
    start: Start


def pairs_of(choice: Choice, most: int = MOST) -> tuple[Pair, ...]:
    """Pairs that more presses should set apart: names that cannot be told apart, and near rivals, the closest first."""
    found: list[Pair] = []
    named = {n.name for n in choice.named}
    for one in choice.named:
        own = _round_of(choice, one.name)
        if own is None:
            continue
        best = own.falls[one.name]
        for rival, fall in own.falls.items():
            if rival in named or not (rival in one.consistent_with or fall >= NEAR * best):
                continue
            start = _start(choice, own, one.name, rival)
            if start is not None:
                apart = max(0.0, best - fall)
                found.append(Pair(one.name, rival, apart, min(1.0, apart / best), start))
    return tuple(sorted(found, key=lambda p: p.unlike)[:most])


def _round_of(choice: Choice, name: str) -> Round | None:
    """The round in which an effect was named."""
    return next((r for r in reversed(choice.rounds) if name in r.falls and r.falls[name] > 0), None)


def _start(choice: Choice, own: Round, first: str, rival: str) -> Start | None:
    """The model after the choice with one effect replaced by what the search found of a rival."""
    found = next((f for f in own.found if f.effect == rival), None)
    if found is None:
        return None
    after = choice.after
    keep = np.array([c.effect != first for c in after.coords], dtype=np.bool_)
    coords = tuple(c for c in after.coords if c.effect != first)
    held = {name: value for name, value in after.held.items() if name != first}
    x = np.concatenate([after.refit.x[keep], found.x])
    return (*coords, *found.start.coords), x, {**held, **found.start.held}
