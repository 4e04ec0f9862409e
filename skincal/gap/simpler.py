"""Of effects that explain about as much, the one that needs fewest numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from skincal.gap.choice_options import ChoiceOptions
from skincal.gap.models import Model


def simplest(alike: Sequence[str], falls: Mapping[str, float], fits: Mapping[str, Model]) -> str:
    """Of effects that explain about as much the one that explains most, those with numbers for each taxel last.

    Args:
        alike: effects that explain about as much, at least one.
        falls: what each explains.
        fits: the model with each.
    """

    def order(name: str) -> tuple[int, float]:
        return of_taxels(fits[name], name), -falls[name]

    return min(alike, key=order)


def fewest(
    name: str,
    falls: Mapping[str, float],
    fits: Mapping[str, Model],
    options: ChoiceOptions,
    values: int,
    enough: float = 0.0,
) -> str:
    """Of effects that explain as much as one does, but for what is too little to be named, that with fewest numbers.

    Args:
        name: of the one.
        falls: what each explains.
        fits: the model with each.
        options: say what is as much, and what is too little.
        values: that were read.
        enough: what another one must explain to be named at all.
    """
    level = of_taxels(fits[name], name)
    least = max(options.broad * falls[name], falls[name] - options.least(values), enough)
    close = [name, *(n for n in fits if falls[n] >= least and of_taxels(fits[n], n) == level)]

    def order(other: str) -> tuple[int, float]:
        return sum(c.effect == other for c in fits[other].coords), -falls[other]

    return min(close, key=order)


def of_taxels(model: Model, name: str) -> int:
    """How many numbers of single taxels an effect of a model has."""
    own = [c for c in model.coords if c.effect == name and c.is_strength]
    return sum(c.parameter.shape == "per-taxel" for c in own)
